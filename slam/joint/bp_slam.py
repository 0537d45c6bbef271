"""BP-SLAM: the joint filter of EKF-SLAM with association by belief propagation, on Gaussians."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from cellslam.slam.front_end.visibility import transitions
from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.state.layout import BELIEF, Rules


class BpSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.bp-slam`."""

    hypotheses: Literal[1] = Field(1, description="one Gaussian: it is the mean over all associations")
    drop_probability: float = Field(
        1e-3, gt=0, lt=1, description="an unconfirmed feature less likely to exist is dropped, a new one not kept"
    )


class BpSlam(JointFilter):
    """Sum-product message passing between agent, features (VTs) and association variables, snapshot by snapshot.

    Source: Leitinger, Meyer, Hlawatsch, Tufvesson and Win, "A belief propagation algorithm for multipath-based SLAM",
    IEEE Trans. Wireless Commun. 18, 2019, whose messages are particles; here agent, features and errors are one
    Gaussian.
    """

    name: ClassVar[str] = "bp-slam"
    Options: ClassVar[type[BpSlamOptions]] = BpSlamOptions
    mode: ClassVar[int] = BELIEF

    def __init__(self, options: BpSlamOptions | None = None) -> None:
        self.options: BpSlamOptions = options or BpSlamOptions()

    def _rules(self, common: Rules, dt_s: float) -> Rules:
        o = self._fusion.options
        stay, back = transitions(o, dt_s) if dt_s > 0.0 else (1.0, 0.0)
        return common._replace(
            stay=stay, back=back, detection=o.detection_probability, drop=o.drop_probability,
            birth=o.birth_ratio / (1.0 - o.birth_ratio),
        )  # fmt: skip
