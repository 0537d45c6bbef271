"""What estimators assume of the front end: detection, clutter, coming and going of VTs, and errors that persist.

Three kinds of error of a measurement, as `sim.lte` makes them:

    white         Q = Q_floor + Q_0 / lambda, lambda the linear SNR (paper, section IV, corrected: more SNR,
                  less variance)
    of place      diffuse energy: changes over a fraction of a metre, the same for the links of one port of a site
    of direction  calibration of the array, scattering by the roof: functions of the direction of arrival in the body
                frame, alike for all paths from about one direction, and they change only as the direction changes

A single measurement has the sum of the variances; to associate, take that. Many measurements in a row share a draw: the
mean of n of them has the variance of n / repeats independent ones. To update, take the variance times `repeats`, and
times the links that share it.

Sources: paper, eq. 34, corrected; Priestley, "Spectral analysis and time series", 1981, section 5.3 (variance of the
mean of a correlated sequence).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.recording import Floats


class FrontEndOptions(BaseModel):
    """The options that map builders share; defaults for the statistical LTE front end."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection_probability: float = Field(
        0.88, gt=0, lt=1, description="probability that a visible VT is detected in one snapshot and link"
    )
    clutter_density: float = Field(
        1e-2, gt=0, le=1e3, description="clutter per link and snapshot and unit of (m rad rad), where VTs are"
    )
    birth_ratio: float = Field(
        0.01, gt=0, lt=1, description="probability that an unexplained measurement is a new VT rather than clutter"
    )
    visible_s: float = Field(10.0, gt=0, le=1e4, description="mean time for which a VT stays visible, s")
    hidden_s: float = Field(10.0, gt=0, le=1e5, description="mean time for which a known VT stays hidden, s")
    confirm_hits: int = Field(5, ge=1, le=100, description="detections after which a VT is confirmed")
    drop_probability: float = Field(
        1e-4, gt=0, lt=1, description="an unconfirmed VT less likely than this to be visible is dropped"
    )
    gate: float = Field(
        16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which nothing associates (chi-square)"
    )
    noise_model: Literal["snr", "claimed"] = Field(
        "snr", description="measurement covariance: scaled by the SNR, or as the front end claims per path"
    )
    noise_floor_m: float = Field(0.0, ge=0, le=100, description="white distance deviation at infinite SNR, m")
    noise_floor_azimuth_deg: float = Field(0.0, ge=0, le=90, description="the same for azimuth, deg")
    noise_floor_elevation_deg: float = Field(0.0, ge=0, le=90, description="the same for elevation, deg")
    noise_unit_snr_m: float = Field(0.0405, ge=0, le=1000, description="distance deviation due to noise at 0 dB, m")
    noise_unit_snr_azimuth_deg: float = Field(0.0685, ge=0, le=90, description="the same for azimuth, deg")
    noise_unit_snr_elevation_deg: float = Field(0.0704, ge=0, le=90, description="the same for elevation, deg")
    place_m: float = Field(
        0.71, ge=0, le=100, description="distance error that changes with the place (diffuse energy), m"
    )
    place_azimuth_deg: float = Field(0.80, ge=0, le=90, description="the same for azimuth, with the array's sway, deg")
    place_elevation_deg: float = Field(0.71, ge=0, le=90, description="the same for elevation, deg")
    place_scale_m: float = Field(0.15, ge=0, le=1000, description="way over which it is drawn anew, m; 0: white")
    direction_m: float = Field(
        0.2, ge=0, le=100, description="distance error that is a function of the direction of arrival (array), m"
    )
    direction_azimuth_deg: float = Field(0.65, ge=0, le=90, description="the same for azimuth (array, roof), deg")
    direction_elevation_deg: float = Field(1.25, ge=0, le=90, description="the same for elevation, deg")
    direction_distance_scale_deg: float = Field(
        15.0, ge=0, le=180, description="change of direction over which the distance's is drawn anew, deg; 0: white"
    )
    direction_scale_deg: float = Field(
        4.0, ge=0, le=180, description="change of direction over which the angles' are drawn anew, deg; 0: white"
    )
    sharing: Literal["none", "site"] = Field(
        "site", description="whether what the ports and sectors of a site measure of a path is taken together"
    )
    misfit_scale_s: float = Field(
        20.0, ge=0, le=1e4, description="time over which directions show to be worse than expected, s; 0: never"
    )
    pitch_deg: float = Field(
        0.1, ge=0, le=20, description="deviation of a pitch that the odometry does not see, deg; 0: level"
    )
    roll_deg: float = Field(0.3, ge=0, le=20, description="the same for roll, deg; 0: level")
    attitude_scale_s: float = Field(3.0, gt=0, le=1e4, description="time over which pitch and roll change, s")
    typical_range_m: float = Field(
        200.0, gt=0, le=1e5, description="distance of a typical VT: driving on turns its direction by speed / range, m"
    )

    @cached_property
    def noise(self) -> tuple[Floats, Floats]:
        """White variances (3,) in m^2, rad^2, rad^2: at infinite SNR, and what noise adds at 0 dB."""
        floor = self.noise_floor_m, self.noise_floor_azimuth_deg, self.noise_floor_elevation_deg
        unit = self.noise_unit_snr_m, self.noise_unit_snr_azimuth_deg, self.noise_unit_snr_elevation_deg
        return _variances(*floor), _variances(*unit)

    @cached_property
    def persisting(self) -> tuple[Floats, Floats]:
        """Variances (3,) in m^2, rad^2, rad^2 of the errors of place and of direction."""
        return (
            _variances(self.place_m, self.place_azimuth_deg, self.place_elevation_deg),
            _variances(self.direction_m, self.direction_azimuth_deg, self.direction_elevation_deg),
        )

    @cached_property
    def scales(self) -> Floats:
        """Over what errors are drawn anew (4,): way (m) for those of place, change of direction (rad) for those of
        direction in distance and in angles, and how far off VTs are for that (m)."""
        by_direction = math.radians(self.direction_distance_scale_deg), math.radians(self.direction_scale_deg)
        return np.array([self.place_scale_m, *by_direction, self.typical_range_m])


def _variances(distance_m: float, azimuth_deg: float, elevation_deg: float) -> Floats:
    return np.square([distance_m, math.radians(azimuth_deg), math.radians(elevation_deg)])
