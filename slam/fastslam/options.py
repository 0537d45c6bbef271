"""Options of the extended FastSLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class FastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.fastslam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

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
    resampling: Literal["systematic", "stratified", "residual", "multinomial"] = Field(
        "systematic", description="resampling scheme"
    )
    effective_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="resample when the effective sample size falls below this share of the particles",
    )
    detection_probability: float = Field(
        0.88, gt=0, lt=1, description="probability that a visible VT is detected in one snapshot and link"
    )
    clutter_density: float = Field(
        3e-4, gt=0, le=1e3, description="clutter per link and snapshot and unit of (m rad rad)"
    )
    birth_ratio: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="probability that an unexplained measurement is a new VT rather than clutter",
    )
    link_correlation: float = Field(
        1.0,
        ge=0,
        le=1,
        description="1: the links of a site see the same VTs come and go, and count once; 0: each for itself",
    )
    visible_s: float = Field(10.0, gt=0, le=1e4, description="mean time for which a VT stays visible, s")
    hidden_s: float = Field(10.0, gt=0, le=1e5, description="mean time for which a known VT stays hidden, s")
    confirm_hits: int = Field(3, ge=1, le=100, description="detections after which a VT is confirmed")
    drop_probability: float = Field(
        1e-4, gt=0, lt=1, description="an unconfirmed VT less likely than this to be visible is dropped"
    )
    gate: float = Field(
        16.3,
        gt=0,
        le=1000,
        description="squared Mahalanobis distance beyond which nothing associates (chi-square, 3 degrees)",
    )
    vts_per_link: int = Field(24, ge=1, le=4096, description="VTs kept per particle and link")
    noise_floor_m: float = Field(0.57, ge=0, le=100, description="white distance deviation at infinite SNR, m")
    noise_floor_azimuth_deg: float = Field(
        0.66, ge=0, le=90, description="white azimuth deviation at infinite SNR, deg"
    )
    noise_floor_elevation_deg: float = Field(
        0.63, ge=0, le=90, description="white elevation deviation at infinite SNR, deg"
    )
    noise_unit_snr_m: float = Field(0.0405, ge=0, le=1000, description="distance deviation due to noise at 0 dB, m")
    noise_unit_snr_azimuth_deg: float = Field(
        0.0685, ge=0, le=90, description="azimuth deviation due to noise at 0 dB, deg"
    )
    noise_unit_snr_elevation_deg: float = Field(
        0.0704, ge=0, le=90, description="elevation deviation due to noise at 0 dB, deg"
    )
    noise_model: Literal["snr", "claimed"] = Field(
        "snr", description="measurement covariance: scaled by the SNR, or as the front end claims per path"
    )
    persisting_m: float = Field(
        0.2, ge=0, le=100, description="distance error that depends on the direction of arrival and is no new draw, m"
    )
    persisting_azimuth_deg: float = Field(0.65, ge=0, le=90, description="the same for azimuth, deg")
    persisting_elevation_deg: float = Field(1.25, ge=0, le=90, description="the same for elevation, deg")
    persisting_scale_deg: float = Field(
        6.0, gt=0, le=180, description="change of direction over which a persisting error is drawn anew, deg"
    )
    persisting_range_m: float = Field(
        200.0, gt=0, le=1e5, description="distance of a typical VT: driving on turns its direction by speed / range, m"
    )
    likelihood_exponent: float = Field(
        1.0, gt=0, le=1, description="tempering: the weights take the likelihood to this power"
    )
