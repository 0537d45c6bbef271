"""The textbook covariance recursion of a drive's linear model: every state is there from the start."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from cellslam.benchmarks.bound.linear_model import linear_model
from cellslam.sim.recording import Floats, Recording


class Step(NamedTuple):
    """Transition F, covariance Q of what it adds, H, variances R, residuals and gain K of a snapshot."""

    F: Floats
    Q: Floats
    H: Floats
    R: Floats
    residual: Floats
    K: Floats


class JointFilter:
    """Core, VTs of a broad prior (or of the covariance that is `known` of them), persisting errors."""

    def __init__(self, recording: Recording, broad_std: float = 1e5, known: Floats | None = None) -> None:
        self.core, self.drive = linear_model(recording)
        self.errors = self.core.size + 3 * len(recording.truth.vts)  # type: ignore[union-attr]
        self.size = len(self.drive.states.last)
        vts = broad_std**2 * np.eye(self.errors - self.core.size) if known is None else known
        self.P: Any = block_diag(np.diag(self.drive.motion.start), vts, np.eye(self.size - self.errors))
        self.prior = self.drive.prior
        if known is None:
            self.P[self.prior.state, self.prior.state] = self.prior.variance

    def transition(self, t: int) -> tuple[Floats, Floats]:
        """F and Q of all states."""
        core, states = self.core.size, self.drive.states
        a = states.decay[t, states.kind]
        F, Q = np.diag(a), np.diag(1.0 - a**2)
        F[:core, :core], Q[:core, :core] = self.drive.motion.F[t], self.drive.motion.Q[t]
        return F, Q

    def rows(self, t: int) -> tuple[Floats, Floats, Floats]:
        """H, variances and residuals of what was measured in a snapshot."""
        views, s = self.drive.views, self.drive.sightings
        low, high = s.rows[t : t + 2]
        H = np.zeros((high - low, 3, self.size))
        for i, m in enumerate(range(low, high)):
            view = s.view_of[m]
            for r in range(3):
                states = [*views.state[view, r], s.state[m, r]]
                for state, load in zip(states, [*views.load[view, r], s.load[r]], strict=True):
                    H[i, r, state] += load * (state >= 0)
        R = s.variance[low:high]
        there = np.isfinite(R)
        return H[there], R[there], s.residual[low:high][there]

    def steps(self) -> Iterator[Step]:
        """Run; yield what each snapshot does, when its covariance P is ready."""
        for t in range(len(self.drive.motion.jump)):
            F, Q = self.transition(t) if t else (np.eye(self.size), np.zeros((self.size, self.size)))
            self.P = F @ self.P @ F.T + Q
            H, R, residual = self.rows(t)
            K = np.linalg.solve(H @ self.P @ H.T + np.diag(R), H @ self.P).T
            left = np.eye(self.size) - K @ H
            self.P = left @ self.P @ left.T + (K * R) @ K.T
            yield Step(F, Q, H, R, residual, K)

    def run(self) -> tuple[Floats, Floats, Floats]:
        """Return covariances of the pose, deviations of the offsets, and errors of the pose as they were drawn."""
        poses, offsets, errors, error = [], [], [], np.zeros(self.size)
        error[self.prior.state] = self.prior.error
        for t, step in enumerate(self.steps()):
            error = step.F @ error
            error[: self.core.size] += self.drive.motion.jump[t]
            error += step.K @ (step.residual - step.H @ error)
            poses.append(self.P[:6, :6].copy())
            offsets.append(np.sqrt(np.diag(self.P)[self.core.offsets]))
            errors.append(error[:6].copy())
        return np.array(poses), np.array(offsets), np.array(errors)


def apart(found: Floats, expected: Floats) -> float:
    """The largest difference of covariances (T, n, n) in their deviations."""
    scale = np.sqrt(np.einsum("tii->ti", expected) + 1e-12)
    return float((np.abs(found - expected) / (scale[:, :, None] * scale[:, None, :])).max())
