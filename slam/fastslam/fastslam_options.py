"""Options of FastSLAM."""

from __future__ import annotations

from pydantic import Field

from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions


class FastSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.fastslam`: the options of EKF-SLAM, and the number of particles."""

    particles: int = Field(1000, ge=1, le=1_000_000, description="number of hypotheses of the associations at most")
