"""Options of the extended FastSLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions


class FastSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.fastslam`, beside what the front end is like."""

    particles: int = Field(1000, ge=1, le=1_000_000, description="number of particles; with errors as states, at most")
    particles_start: int | None = Field(
        None,
        ge=1,
        le=1_000_000,
        description="number of particles while the clock offsets are wide; none: as `particles`",
    )
    start_phase_s: float = Field(75.0, ge=0, le=3600, description="how long particles_start are kept, s")
    offset_component_std_m: float = Field(
        20.0, gt=0, le=1000, description="width of one particle's clock-offset component at the start, m"
    )
    motion: Literal["marginalised", "sampled"] = Field(
        "marginalised", description="yaw-rate bias and odometer scale: marginalised with the offsets, or sampled"
    )
    criterion: Literal["likelihood", "mahalanobis"] = Field(
        "likelihood",
        description="what is best: the likelihood against misses and clutter, or the paper's bare distance",
    )
    clock: Literal["marginalised", "sampled", "known"] = Field(
        "marginalised", description="clock offsets: marginalised per site, sampled, or known (the prior's mean)"
    )
    resampling: Literal["systematic", "stratified", "residual", "multinomial"] = Field(
        "systematic", description="resampling scheme"
    )
    effective_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="resample when the effective sample size falls below this share of the particles",
    )
    evidence_lasts: bool = Field(
        True,
        description="whether evidence on which VT is seen lasts as errors do, and counts as much less as the fit does",
    )
    link_correlation: float = Field(
        1.0,
        ge=0,
        le=1,
        description="1: the links of a site see the same VTs come and go, and count once; 0: each for itself",
    )
    vts_per_link: int = Field(
        4096, ge=1, le=65536, description="VTs kept per particle and link at most; then the least certain makes room"
    )
    merging: bool = Field(True, description="whether confirmed VTs of a link that have become one are merged")
    likelihood_exponent: float = Field(
        1.0, gt=0, le=1, description="tempering: the weights take the likelihood to this power"
    )

    @model_validator(mode="after")
    def _of_one_filter(self) -> Self:
        """Refuse options of the filter with errors counted where errors are states."""
        own = set(FastSlamOptions.model_fields) - set(EkfSlamOptions.model_fields) - {"particles"}
        for name in sorted(own & self.model_fields_set) if self.errors == "states" else ():
            if getattr(self, name) != FastSlamOptions.model_fields[name].default:
                raise ValueError(f"{name} is an option of the filter with errors counted: set errors=counted, too")
        return self
