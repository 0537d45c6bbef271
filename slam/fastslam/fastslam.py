"""FastSLAM for now: the joint filter of EKF-SLAM with many hypotheses of the associations."""

from __future__ import annotations

from typing import ClassVar

from cellslam.slam.ekf_slam.ekf_slam import JointFilter
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions


class FastSlam(JointFilter):
    """EKF-SLAM with `particles` hypotheses at most; a particle filter over the vehicle's path is to take its place."""

    name: ClassVar[str] = "fastslam"
    Options: ClassVar[type[FastSlamOptions]] = FastSlamOptions

    def __init__(self, options: FastSlamOptions | None = None) -> None:
        given = options or FastSlamOptions()
        super().__init__(given.model_copy(update={"hypotheses": given.particles}))
