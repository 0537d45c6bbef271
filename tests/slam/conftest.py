from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cellslam.sim.recording import Floats, Links, OdometryModel, Sites
from cellslam.slam.api import Setup
from cellslam.slam.ekf_slam.filter_bank import new_bank, scratch_of
from cellslam.slam.ekf_slam.state_layout import FREE, Core, Measured, Rules, one_of, states
from cellslam.slam.ekf_slam.update_kernel import expect

OFFSET, CORE = 6, 7  # the clock offset's place behind the pose, the first VT's behind that


class OneFilter:
    """A joint filter `f` of pose, one clock offset and VTs, on one link, with scratch `w` (NaN) for its kernels."""

    def __init__(self, places: int, **rules: Any) -> None:
        none, nowhere = np.zeros(1, np.int64), np.zeros(6)
        setup = Setup(
            Links(none, none, none), Sites(("A",), np.zeros(1), np.ones(1)), OdometryModel(*(np.zeros((4, 6)))),
            nowhere, nowhere,
        )  # fmt: skip
        self.rules = Rules(**{"mode": FREE, "log_clutter": 0.0, "gate": 16.3, "birth": 0.0, "confirm": 3,
                              "age_once": 9, "age_twice": 9, **rules})  # fmt: skip
        bank = new_bank(setup, Core.of(setup), self.rules.mode, places, np.zeros((1, 1)), np.zeros(1))
        self.f, self.w = one_of(bank.arrays, 0), scratch_of(CORE + 3 * places, places, 12, self.rules)
        for part in self.w:
            if isinstance(part, np.ndarray) and part.dtype == float:
                part[:] = np.nan

    def put(self, pose: Any, offset_m: float, *vts: Any, anchor: Any = (0.0, 0.0, 0.0)) -> None:
        """Set the mean: pose (6,), clock offset, VTs (range, azimuth, elevation) about an anchor (3,)."""
        self.f.x[: CORE + 3 * len(vts)] = np.concatenate([pose, [offset_m], *vts])
        self.f.anchor[: len(vts), :3], self.f.count[0] = anchor, len(vts)

    def model(self, j: int) -> tuple[Floats, Floats]:
        """Return what is expected of a measurement of VT j (3,), and its whole Jacobian H (3, states)."""
        expected, _ = expect(self.f, j, OFFSET, self.w.h, self.w.t)
        whole, v = np.zeros((3, states(self.f))), CORE + 3 * j
        whole[:, :CORE], whole[:, v : v + 3] = self.w.h[:, :CORE], self.w.h[:, CORE:]
        return np.array(expected) + self.f.x[OFFSET] * np.eye(3)[0], whole

    def seen(self, z: Floats, q: Floats) -> Measured:
        """Return measurements z (m, 3) of variances q (m, 3) as the kernels take them."""
        m = len(z)
        return Measured(
            0, 0, np.array([0, m]), np.zeros(1, np.int64), z, q, q, np.zeros(m), np.zeros(m), z, q,
            np.full(m, -2), np.zeros((2, 2, 1)), self.rules,
        )  # fmt: skip

    def place(self, j: int) -> Floats:
        """Return the position (3,) of VT j."""
        rho, az, el = self.f.x[CORE + 3 * j : CORE + 3 * j + 3]
        direction = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
        return np.asarray(self.f.anchor[j, :3] + rho * direction)


@pytest.fixture
def one_filter() -> type[OneFilter]:
    return OneFilter


@pytest.fixture
def kalman() -> Callable[..., tuple[Floats, Floats, float]]:
    """The textbook update by an innovation e (NaN: not measured) of variances q: mean, covariance, log N(e; 0, S)."""

    def updated(x: Floats, p: Floats, h: Floats, e: Floats, q: Floats) -> tuple[Floats, Floats, float]:
        there = np.isfinite(e)
        e, h = e[there], h[there]
        s = h @ p @ h.T + np.diag(q[there])
        gain = np.linalg.solve(s, h @ p).T
        log_density = -0.5 * (e @ np.linalg.solve(s, e) + np.log(np.linalg.det(2.0 * np.pi * s)))
        return x + gain @ e, p - gain @ s @ gain.T, float(log_density)

    return updated
