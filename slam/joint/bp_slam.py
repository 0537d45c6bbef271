"""BP-SLAM: the joint filter of EKF-SLAM with association by belief propagation, on Gaussians.

State
    The Gaussian of EKF-SLAM (ekf_slam.py), and of each feature (VT) the probability r that it exists and is visible
                                                                              anchor[:, EXISTS] in state/layout.py: Vts
Recursion, in a snapshot, for each link
    predict     r <- r stay + (1 - r) back                       association_kernel.py: believe; `back` if confirmed
    messages    beta = r p_D / (1 - r p_D) N(e; 0, S) / clutter        of a legacy feature, against a missed detection
                xi = birth ratio, where a feature can begin            of a new feature, against clutter
                zeta = beta / (1 + sum of the other beta nu)           features to measurements: pass_messages
                nu = 1 / (1 + xi + sum of the other zeta)              measurements to features
    update      d = sum over measurements of beta nu / (1 + sum of beta nu)      P(the feature was detected)
                r <- d + (1 - d) r (1 - p_D) / (1 - r p_D)
                the state by each pair that is more likely than not, as EKF-SLAM does
    begin       new features with r = xi / (1 + xi + sum of zeta), if that is not below `drop`
    drop        unconfirmed features whose r is below it         snapshot/birth_kernel.py: tidy

The weight is 1: it is one Gaussian, the mean over all associations. Source: Leitinger, Meyer, Hlawatsch, Witrisal,
Tufvesson and Win, "A belief propagation algorithm for multipath-based SLAM", IEEE Trans. Wireless Commun. 18, 2019,
whose messages are particles; here agent, features and errors are one Gaussian.
"""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.state.layout import BELIEF, Existence, Rules
from cellslam.slam.measurements.measurement_options import transitions


class BpSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.bp-slam`."""

    drop_probability: float = Field(
        1e-3, gt=0, lt=1, description="an unconfirmed feature less likely to exist is dropped, a new one not kept"
    )


class BpSlam(JointFilter):
    """Sum-product message passing between agent, features and association variables, snapshot by snapshot."""

    name: ClassVar[str] = "bp-slam"
    Options: ClassVar[type[BpSlamOptions]] = BpSlamOptions
    mode: ClassVar[int] = BELIEF

    def __init__(self, options: BpSlamOptions | None = None) -> None:
        self.options: BpSlamOptions = options or BpSlamOptions()

    def _rules(self, common: Rules, dt_s: float) -> Rules:
        o = self._fusion.options
        stay, back = transitions(o, dt_s) if dt_s > 0.0 else (1.0, 0.0)
        existence = Existence(
            birth=o.birth_ratio / (1.0 - o.birth_ratio), stay=stay, back=back, detection=o.detection_probability,
            drop=o.drop_probability,
        )  # fmt: skip
        return common._replace(existence=existence)
