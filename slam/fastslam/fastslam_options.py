"""Options of the extended FastSLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from cellslam.slam.front_end.front_end_options import FrontEndOptions


class FastSlamOptions(FrontEndOptions):
    """What a scenario may set under `estimator.fastslam`, beside what the front end is like."""

    gate: float = Field(
        36.0,
        gt=0,
        le=1000,
        description="squared Mahalanobis distance beyond which nothing associates; wide, as particles know their pose",
    )
    particles: int = Field(1000, ge=1, le=1_000_000, description="number of particles")
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
    proposal: Literal["motion", "measurements"] = Field(
        "motion", description="what motion is drawn from: the odometry (FastSLAM 1.0), or the snapshot too (2.0)"
    )
    association: Literal["hungarian", "sampled"] = Field(
        "hungarian", description="how a link's measurements are given to VTs in each particle"
    )
    hypotheses: int = Field(8, ge=1, le=1000, description="assignments that a sampled association draws from")
    association_seed: int = Field(0, ge=0, le=2**31, description="seed of sampled associations")
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
