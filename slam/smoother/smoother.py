"""The smoother: EKF-SLAM online, and at the end of the drive a factor graph, the maximum-a-posteriori estimate.

State
    keyframe poses X_k, odometry errors E_g (biases, scales) of segments, a clock offset b_s of each site, VTs L_v
                                                                          factor_graph.py: Problem
Cost, minimised by Levenberg and Marquardt                                factor_graph.py: solve, _graph
    |X_0 - start|^2 + |E_0|^2 + sum |b_s - mean|^2                        priors, each in its deviations
    + sum_k |Log(odometry_k^-1 X_k^-1 X_k+1) - J_k E_g(k)|^2              odometry between keyframes: _driven;
                                                                          drive_factors.py: leg (J_k: by_error)
    + sum_g |E_g+1 - E_g|^2                                               biases walk: _walk
    + sum rho(mean of h(X_k, L_v) + b_s - z)                              sightings: _seen; residual
                                                                          rho: Huber's loss
Outliers
    sightings beyond `gate` are left out, and the graph is solved again; associations are those of EKF-SLAM.
Between keyframes
    odometry, whose misclosure is spread evenly                           drive_factors.py: between

Sources: Dellaert and Kaess, "Factor graphs for robot perception", Foundations and Trends in Robotics 6, 2017, and their
library GTSAM (package extra `gtsam`).
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import ClassVar

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.smoother.smoother_options import SmootherOptions


class Smoother:
    """Batch estimate over the whole drive: what a method that need not be causal reaches.

    While driving it answers as EKF-SLAM, whose associations it takes; the poses of `finish` come from the graph.
    """

    name: ClassVar[str] = "smoother"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[SmootherOptions]] = SmootherOptions

    def __init__(self, options: SmootherOptions | None = None) -> None:
        if find_spec("gtsam") is None:
            raise InputError("estimator 'smoother' needs GTSAM: pip install 'cellslam[gtsam]'")
        self.options = options or SmootherOptions()
        self._filter = EkfSlam(self.options.ekf_slam)

    def warm_up(self) -> None:
        """Compile EKF-SLAM and the residual."""
        from cellslam.slam.smoother.factor_graph import residual

        self._filter.warm_up()
        row, small = np.zeros(3), np.zeros((3, 3))
        residual(small, row, row + 1.0, 0.0, np.zeros((1, 12)), np.zeros((1, 3)), row.copy(), np.zeros((3, 6)), small)

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Begin a drive."""
        self._setup = setup
        self._filter.start(setup, rng)
        self._dt_s: list[float] = []
        self._odometry: list[Floats] = []
        self._snapshots: list[Snapshot] = []
        self._association: list[Ints] = []
        self._poses: list[Floats] = []
        self._vts: dict[int, Floats] = {}
        self._offset: Floats = setup.sites.clock_offset_mean_m

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Answer as EKF-SLAM, and keep what the graph needs.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        answer = self._filter.step(dt_s, odometry, snapshot)
        self._dt_s.append(dt_s)
        self._odometry.append(np.array(odometry))
        self._snapshots.append(snapshot)
        self._poses.append(answer.pose.copy())
        association, vts, offset = answer.association, answer.vts, answer.clock_offset_m
        none = np.full(len(snapshot), -1, np.int64)
        self._association.append(none if association is None else association.copy())
        if vts is not None:
            self._vts.update(zip(vts.id.tolist(), vts.position_m.copy(), strict=True))
        if offset is not None:
            self._offset = offset.copy()
        return answer

    def finish(self) -> Floats | None:
        """Return the smoothed poses (T, 6) in m and rad; None for a drive of fewer than two snapshots."""
        from cellslam.slam.smoother.drive_factors import Drive, between, problem_of
        from cellslam.slam.smoother.factor_graph import solve

        if len(self._poses) < 2:
            return None
        o, drive = self.options, Drive(
            setup=self._setup, dt_s=np.array(self._dt_s), odometry=np.array(self._odometry),
            snapshots=self._snapshots, association=self._association, poses=np.array(self._poses), vts=self._vts,
            offset_m=self._offset,
        )  # fmt: skip
        problem, frames = problem_of(drive, o)
        solution = solve(problem, o.gate, o.huber, o.rounds, o.iterations)
        return between(solution.keyframes, problem.legs, frames)
