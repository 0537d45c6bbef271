"""Options of EKF-SLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Self

from pydantic import Field, model_validator

from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.model.calibration import Calibration


class EkfSlamOptions(MeasurementOptions):
    """What a scenario may set under `estimator.ekf-slam`, as under every filter with one joint covariance."""

    gate: float = Field(
        36.0, gt=0, le=1000, description="squared Mahalanobis distance beyond which nothing associates (chi-square)"
    )
    return_odds: float = Field(
        0.3,
        gt=0,
        le=1e9,
        description="how likely a measurement must be of a VT unseen for 3 s, against a new one nearby",
    )
    ground_share: float = Field(
        0.0, ge=0, le=10, description="share of the ground's reflection that merges with each path, deviation; 0: none"
    )
    block_s: float = Field(
        0.6, ge=0, le=1.2, description="measurements of a VT are averaged over so long at most, s; 0: never"
    )
    hold_s: float = Field(40.0, gt=0, le=1e6, description="time for which the roof's errors in a direction are kept, s")
    merge_rate: float = Field(
        0.003, ge=0, le=10, description="how often another path merges with that of a VT, 1/s; 0: never"
    )
    vts: int = Field(100, ge=4, le=2000, description="VTs in the joint state; new ones displace the longest unseen")
    elevation_std_deg: float = Field(
        20.0, gt=0, le=90, description="deviation of a new VT's elevation from the horizon where none is measured, deg"
    )
    component_share: float = Field(
        0.1, gt=0, le=1, description="width of one component of the clock-offset prior at the start, in typical_range_m"
    )
    component_step: float = Field(1.25, gt=0, le=3, description="distance of neighbouring components, in their widths")
    resolved_share: float = Field(
        0.075, gt=0, le=1, description="a clock offset known to this is resolved, in typical_range_m"
    )
    start_limit_s: float = Field(600.0, ge=0, le=1e5, description="the start ends at this time at the latest, s")
    scatterers: bool | None = Field(
        None, description="whether paths may be scattered at points, or be nothing lasting; none: as the recording says"
    )
    step_probability: float = Field(
        1e-6, ge=0, lt=1, description="probability that a site's clock steps within a block, where it may; 0: never"
    )
    slip_probability: float = Field(
        0.0, ge=0, lt=1, description="probability that wheels slip within a block, by 30 % of its distance or turn"
    )
    prune_ratio: float = Field(1e-5, gt=0, lt=1, description="components less likely than the best by this are dropped")
    calibration_file: str | None = Field(
        None, min_length=1, description="file of the array's calibration as an earlier drive found it, to begin with"
    )

    @property
    def component_std_m(self) -> float:
        """The width of one component of the clock-offset prior at the start, in m."""
        return self.component_share * self.typical_range_m

    @cached_property
    def known_calibration(self) -> Calibration | None:
        """The calibration to begin with. Raises InputError where the file is none."""
        return None if self.calibration_file is None else Calibration.load(self.calibration_file)

    @model_validator(mode="after")
    def _can_begin(self) -> Self:
        """Refuse a calibration that is none, or that the filter cannot begin with."""
        if self.known_calibration is not None:
            from cellslam.slam.joint.calibration_states import check_fits

            check_fits(self.known_calibration, self.calibration, math.radians(self.calibration_scale_deg))
        return self
