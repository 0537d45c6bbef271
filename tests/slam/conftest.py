from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cellslam.sim.recording import Floats, Links, OdometryModel, Sites
from cellslam.slam.api import Setup
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.snapshot.observation_kernel import coordinates, errors_of, geometry, rotations_of
from cellslam.slam.joint.snapshot.snapshot_kernel import PENDING, new_workspace
from cellslam.slam.joint.snapshot.update_kernel import BlockMeasurement
from cellslam.slam.joint.state import layout
from cellslam.slam.joint.state.layout import FREE, Measured, Rules, block_of, one_of
from cellslam.slam.joint.state.states_kernel import enter, owner_of
from cellslam.slam.model.matrices_kernel import Vec3

NOW = 3  # number of a snapshot


class OneFilter:
    """A joint filter `f` of pose, one clock offset and VTs, on one link, with room `w` for its kernels; with a
    `scale` of range, too, if it is given one."""

    def __init__(self, errors: Any = NO_ERRORS, step_m: float = 0.0, scale: float | None = None, **rules: Any) -> None:
        none, nowhere = np.zeros(1, np.int64), np.zeros(6)
        setup = Setup(
            Links(none, none, none), Sites(("A",), np.zeros(1), np.ones(1), clock_step_std_m=np.array([step_m])),
            OdometryModel(*(np.zeros((4, 6)))), nowhere, nowhere, range_scale_std=0.0 if scale is None else 1.0,
        )  # fmt: skip
        parts: dict[str, Any] = {
            "association": layout.Association(mode=FREE, log_clutter=0.0, gate=16.3, return_log_odds=0.0, away=4),
            "lifetime": layout.Lifetime(confirm=3, age_once=9, age_twice=9, hold=5),
            "blocks": layout.BlockLimits(snapshots=1, distance=1.0, turn=1.0),
            "existence": layout.Existence(),
        }
        for name, part in parts.items():  # `rules` change some of these
            parts[name] = part._replace(**{key: rules.pop(key) for key in part._fields if key in rules})
        self.rules = Rules(**{"evidence": 1.0, **parts, **rules})
        self.errors = errors
        self.mixture = new_mixture(setup, core_of(setup, errors), errors, np.zeros((1, 1)), np.zeros(1))
        self.f, self.block = one_of(self.mixture.arrays, 0), block_of(self.mixture.blocks, 0)
        if scale is not None:
            self.f.x[self.f.core.range_scale] = scale
        self.offset, self.w = self.mixture.core.first_offset, new_workspace(self.f, 12, PENDING)
        self.w.pending.rows[:], self.w.pending.t[:] = np.nan, np.nan

    @property
    def n(self) -> int:
        """How many states there are."""
        return int(self.f.size[0])

    def put(self, pose: Any, offset_m: float, *vts: Any, anchor: Any = (0.0, 0.0, 0.0)) -> None:
        """Set the mean: pose (6,), clock offset; enter VTs (range, azimuth, elevation) about an anchor (3,)."""
        self.f.x[:6], self.f.x[self.offset] = pose, offset_m
        for j, vt in enumerate(vts):
            self.f.vts.state[j] = -1
            for c in range(3):
                self.f.x[enter(self.f, owner_of(j, c, self.f.vts.state.shape[1]), 1.0)] = vt[c]
            self.f.vts.anchor[j, :3], self.f.vts.slots[j, layout.ILLUMINATOR] = anchor, -1
        self.f.count[0] = len(vts)

    def spread(self, root: Floats) -> Floats:
        """Set the covariance of all states to root root^T, and return it."""
        self.f.p[: self.n, : self.n] = root @ root.T
        return np.array(root @ root.T)

    def model(self, j: int) -> tuple[Floats, Floats]:
        """Return what is expected of a measurement of VT j (3,), and its whole Jacobian H (3, n)."""
        f, s = self.f, self.w.jacobian
        h = geometry(f, j, self.offset, Vec3(*f.x[:3]), rotations_of(f), coordinates(f, j), s)
        errors = errors_of(f, self.errors, j, h, 1.0, 1.0, NOW, s)
        whole = np.zeros((3, self.n))
        for k in range(s.size[0]):
            whole[:, s.at[k]] += s.by[:, k]
        return np.array(h) + np.array(errors) + [f.x[self.offset], 0.0, 0.0], whole

    def measurement(self, z: Floats, q: Floats) -> BlockMeasurement:
        """Return a measurement z (3,) of variances q (3,) from where the filter is."""
        pose = self.f.x[:6].copy()
        return BlockMeasurement(
            z, q, q, pose, Vec3(*pose[:3]), rotations_of(self.f), 1.0, 1.0, NOW, self.f.particles.deviation[:6]
        )

    def seen(self, z: Floats, q: Floats) -> Measured:
        """Return measurements z (m, 3) of variances q (m, 3) as the kernels take them."""
        m = len(z)
        return Measured(
            now=NOW, born=100, first=np.array([0, m]), site_of=np.zeros(1, np.int64), given=np.full(m, -2), z=z,
            gap=np.zeros(m), tables=np.zeros((2, 2, 8)),
            noise=layout.Noise(single=q, many=q, merged=np.zeros(3), diffuse=np.ones(m)), births=layout.Births(z, q, 0),
            rules=self.rules,
        )  # fmt: skip

    def place(self, j: int) -> Floats:
        """Return the position (3,) of VT j."""
        rho, az, el = coordinates(self.f, j)
        direction = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
        return np.asarray(self.f.vts.anchor[j, :3] + rho * direction)


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
