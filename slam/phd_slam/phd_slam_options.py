"""Options of PHD-SLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from pydantic import Field

from cellslam.slam.front_end.front_end_options import FrontEndOptions


class PhdSlamOptions(FrontEndOptions):
    """What a scenario may set under `estimator.phd-slam`, beside what the front end is like."""

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )
    iterations: int = Field(2, ge=1, le=20, description="linearisations of the importance density of the motion")
    offset_component_std_m: float = Field(
        20.0, gt=0, le=1000, description="width of one particle's clock-offset component at the start, m"
    )
    drop_weight: float = Field(1e-4, gt=0, lt=1, description="a Gaussian of the map of less weight is dropped")
    merge_distance2: float = Field(
        10.0, gt=0, le=1000, description="squared Mahalanobis distance up to which Gaussians of the map are merged"
    )
    components: int = Field(4096, ge=16, le=65536, description="Gaussians kept in a particle's map at most")
