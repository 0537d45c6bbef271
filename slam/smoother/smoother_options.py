"""Options of the smoother."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions


class SmootherOptions(BaseModel):
    """What a scenario may set under `estimator.smoother`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keyframe_s: float = Field(1.0, gt=0, le=100, description="time between poses of the graph, s")
    bias_s: float = Field(20.0, gt=0, le=1e4, description="time for which odometry biases are taken as constant, s")
    vt_detections: int = Field(10, ge=2, le=1000, description="VTs associated less often are left out")
    gate: float = Field(
        16.3, gt=0, le=1000, description="squared Mahalanobis distance of one measurement beyond which it is an outlier"
    )
    rounds: int = Field(3, ge=1, le=20, description="times to solve, each without the outliers that the last one found")
    huber: float = Field(2.0, gt=0, le=100, description="residuals beyond this many deviations count linearly (Huber)")
    iterations: int = Field(30, ge=1, le=1000, description="most iterations of Levenberg and Marquardt, each time")
    ekf_slam: EkfSlamOptions = Field(EkfSlamOptions(), description="the EKF-SLAM whose associations are taken")
