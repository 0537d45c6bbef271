"""Options of Channel-SLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ChannelSlamOptions(BaseModel):
    """What a scenario may set under `estimator.channel-slam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(300, ge=2, le=100_000, description="particles of the user's pose and odometry errors")
    directions: int = Field(
        48, ge=4, le=1000, description="Gaussian components over the azimuth of a new transmitter, for each particle"
    )
    transmitters: int = Field(40, ge=1, le=1000, description="transmitters in use at a time")
    distance_std_m: float = Field(
        0.9, gt=0, le=100, description="deviation of a tracked distance, with paths taken for one another, m"
    )
    update_m: float = Field(
        0.4, ge=0, le=100, description="way between updates, over which errors of a distance are drawn anew, m"
    )
    outlier_density: float = Field(
        1e-3, gt=0, le=1, description="density of a tracked distance that is not that of its transmitter, 1/m"
    )
    elevation_deg: float = Field(7.0, ge=-90, le=90, description="mean elevation of transmitters before the drive, deg")
    elevation_std_deg: float = Field(5.0, gt=0, le=90, description="deviation of that, deg")
    drop_weight: float = Field(1e-3, gt=0, lt=1, description="a component of less weight is dropped")
    effective_share: float = Field(
        0.5, gt=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )
    kernel_width: float = Field(
        0.2, ge=0, lt=1, description="spread of odometry errors at resampling, in their deviation over the particles"
    )
    track_gate_m: float = Field(3.0, gt=0, le=100, description="a delay further from a track starts another, m")
    track_hits: int = Field(12, ge=1, le=1000, description="detections after which a track is a transmitter")
    track_gap_s: float = Field(1.5, gt=0, le=1000, description="a track not detected for so long has ended, s")
    map_std_m: float = Field(
        20.0, gt=0, le=1e4, description="transmitters less certain than this are left out of the reported map, m"
    )
