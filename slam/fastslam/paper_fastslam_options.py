"""Options of the paper's FastSLAM: each but the first is a step on the ladder from the paper's filter."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class PaperFastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.paper-fastslam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    motion: Literal["sampled", "marginalised"] = Field(
        "marginalised", description="yaw-rate bias and odometer scale: drawn at the start, or marginalised"
    )
    sharing: Literal["none", "site"] = Field(
        "none", description="whether what the ports and sectors of a site measure of a path is fused first"
    )
    noise: Literal["white", "persisting"] = Field(
        "white", description="whether variances are raised for errors that persist from snapshot to snapshot"
    )
    gate: float = Field(16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which a VT begins")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )
