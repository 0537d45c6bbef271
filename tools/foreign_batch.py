"""The yardstick of a foreign world: robust least squares over the whole drive, given the right model and associations.

Minimised by Gauss and Newton's steps from the truth on, with Cauchy weights w = 1 / (1 + r^2 / c^2) of residuals r in
their deviations:

    odometry between keyframes i, j     (x_j - x_i) turned by -heading_i  -  distance travelled / (1 + s),
                                        heading_j - heading_i  -  turn  + b dt
    measurements of feature f           distance - (1 + k) length - offset of its site, azimuth, elevation

over the keyframes' poses, places of features and of transmitters that are not surveyed, offsets of clocks that are not
known, the scale of range k, and scale s and bias b of the odometry. Between keyframes the odometry holds.
Source: Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 4 (robust weights).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Recording
from tools.foreign_drives import HEIGHT_M, World, expected

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
KEYFRAMES, ROUNDS, CAUCHY = 300, 12, 2.4
STEP = 1e-6  # of numerical derivatives
# Deviations as the worlds are drawn with; of places none, but nothing is to be singular.
PRIOR = {"scale": 0.03, "speed": 0.03, "bias": 0.003, "clock": 30.0, "place": 1e4}


def batch_rmse(world: World, recording: Recording) -> float:
    """Return the RMSE (m) of the horizontal positions of the batch solution at all snapshots."""
    poses, steps = world.poses, relative(recording)
    key = np.linspace(0, len(poses) - 1, min(KEYFRAMES, len(poses))).astype(int)
    of = np.searchsorted(key, np.arange(len(poses)), side="right") - 1
    since = [increments(steps, key[of], np.arange(len(poses))), increments(steps, key[:-1], key[1:])]
    problem = Problem(world, recording, key, of, *since)
    x = problem.solved()
    there = composed(x[problem.pose][of], since[0], x[problem.speed])
    return float(np.sqrt(np.mean(np.sum((there[:, :2] - poses[:, :2]) ** 2, axis=1))))


def relative(recording: Recording) -> Floats:
    """Return the dead-reckoned poses (T, 3) from (0, 0, 0) on."""
    dt = np.diff(recording.time_s, prepend=recording.time_s[0])
    u = np.nan_to_num(recording.odometry[:, [0, 3]])
    heading = np.cumsum(u[:, 1] * dt)
    middle = heading - 0.5 * u[:, 1] * dt
    return np.column_stack(
        [np.cumsum(u[:, 0] * dt * np.cos(middle)), np.cumsum(u[:, 0] * dt * np.sin(middle)), heading]
    )


def increments(poses: Floats, first: Ints, second: Ints) -> Floats:
    """Return poses `second` (n, 3) as seen from `first` (n,), of poses (T, 3)."""
    a, d = poses[first], poses[second] - poses[first]
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], wrap_angle(d[:, 2])])


def composed(poses: Floats, step: Floats, speed: Floats | float) -> Floats:
    """Return poses (n, 3) after steps (n, 3) of an odometry whose speed is too large by a share (n,)."""
    c, s, d = np.cos(poses[:, 2]), np.sin(poses[:, 2]), step[:, :2] / (1.0 + np.reshape(speed, (-1, 1)))
    x, y = poses[:, 0] + c * d[:, 0] - s * d[:, 1], poses[:, 1] + s * d[:, 0] + c * d[:, 1]
    return np.column_stack([x, y, poses[:, 2] + step[:, 2]])


class Problem:
    """The unknowns as one vector, and the residuals as functions of small parts of it."""

    def __init__(self, world: World, recording: Recording, key: Ints, of: Ints, since: Floats, between: Floats) -> None:
        t, features = world.traits, world.features
        self.world, self.since, self.between = world, since, between
        self.rows = np.flatnonzero(world.feature >= 0)
        sizes = np.cumsum([0, 3 * len(key), 3 * len(features.site), t.sites, 1, 1, 1])
        self.pose = np.arange(sizes[1]).reshape(-1, 3)
        self.place = np.arange(sizes[1], sizes[2]).reshape(-1, 3)
        self.clock = np.arange(sizes[2], sizes[3])
        self.range_scale, self.speed, self.bias = sizes[3:6]
        truth = np.concatenate(
            [world.poses[key].ravel(), features.place.ravel(), world.clocks_m, [t.range_scale, 0.0, 0.0]]
        )
        self.truth, self.prior = truth, np.full(len(truth), PRIOR["place"])
        self.prior[[self.range_scale, self.speed, self.bias]] = PRIOR["scale"], PRIOR["speed"], PRIOR["bias"]
        self.prior[self.clock] = PRIOR["clock"]
        self.free = np.ones(len(truth), bool)
        self.free[self.pose[0]] = False
        self.free[self.clock] = t.clock_std > 0.0
        if t.known:
            self.free[self.place[: t.sites]] = False
        if t.plane:
            self.free[self.place[:, 2]] = False
        snapshot, feature = world.snapshot[self.rows], world.feature[self.rows]
        site = features.site[feature]
        self.of_row = np.column_stack([
            self.pose[of[snapshot]], self.place[feature], self.place[site], self.clock[site],
            np.full((len(site), 1), self.range_scale), np.full((len(site), 1), self.speed),
        ])  # fmt: skip
        many = len(key) - 1
        self.of_step = np.column_stack([
            self.pose[:-1], self.pose[1:], np.full((many, 1), self.speed), np.full((many, 1), self.bias)
        ])  # fmt: skip
        self.row_since, self.scatters = since[snapshot], features.scatters[feature]
        self.dt_s = np.diff(world.time_s[key])
        columns = world.campaign.columns
        z = [np.asarray(columns[n])[self.rows] if n in columns else np.zeros(len(self.rows))
             for n in ("distance_m", "azimuth_rad", "elevation_rad")]  # fmt: skip
        self.z = np.column_stack(z)
        angle = 1.0 / t.azimuth_std if t.azimuth_std else 0.0
        self.weight = np.array([1.0 / t.range_std, angle, 0.0 if t.plane else angle])
        wrong = self.of_steps(truth[self.of_step])
        self.step_std = np.maximum(1.4826 * np.median(np.abs(wrong), axis=0), (1e-3, 1e-3, 1e-4))

    def of_rows(self, x: Floats) -> Floats:
        """Return the residuals (M, 3), in m and rad, of measurements by their parts (M, 12) of the unknowns."""
        there = composed(x[:, :3], self.row_since, x[:, 11])
        height = 0.0 if self.world.traits.plane else HEIGHT_M
        h = expected(there, x[:, 3:6], x[:, 6:9], self.scatters, height)
        h[:, 0] = (1.0 + x[:, 10]) * h[:, 0] + x[:, 9]
        out = self.z - h
        out[:, 1] = wrap_angle(out[:, 1])
        return out

    def of_steps(self, x: Floats) -> Floats:
        """Return the residuals (K - 1, 3), in m and rad, of the odometry by their parts (K - 1, 8) of the unknowns."""
        expected_pose = composed(x[:, :3], self.between, x[:, 6])
        d = x[:, 3:6] - expected_pose
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        turn = wrap_angle(d[:, 2] + x[:, 7] * self.dt_s)
        return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], turn])

    def solved(self) -> Floats:
        """Return the unknowns that fit best."""
        x = self.truth.copy()
        for _ in range(ROUNDS):
            normal = diags_array(self.prior**-2).tocsc()
            right = (np.where(self.prior < PRIOR["place"], -x, 0.0)) * self.prior**-2
            for function, of, weight in (
                (self.of_rows, self.of_row, self.weight), (self.of_steps, self.of_step, 1.0 / self.step_std)
            ):  # fmt: skip
                residual, jacobian = linearised(function, x, of, weight)
                robust = diags_array(1.0 / (1.0 + (residual / CAUCHY) ** 2))
                normal = normal + jacobian.T @ robust @ jacobian
                right = right - jacobian.T @ (robust @ residual)
            free = np.flatnonzero(self.free)
            x[free] += spsolve(normal[free][:, free].tocsc(), right[free])
        return x


def linearised(function: Callable[[Floats], Floats], x: Floats, of: Ints, weight: Floats) -> tuple[Floats, coo_array]:
    """Return weighted residuals (n q,) and their Jacobian (n q, P), of a function of parts `of` (n, c) of x (P,)."""
    part = x[of]
    residual = function(part) * weight
    n, q = residual.shape
    row = np.arange(n * q).reshape(n, q)
    rows, columns, values = [], [], []
    for c in range(of.shape[1]):
        moved = part.copy()
        moved[:, c] += STEP
        back = part.copy()
        back[:, c] -= STEP
        gap = function(moved) - function(back)
        gap[:, 1:] = np.where(np.abs(gap[:, 1:]) > 3.0, 0.0, gap[:, 1:])
        values.append((gap * weight / (2.0 * STEP)).ravel())
        rows.append(row.ravel())
        columns.append(np.repeat(of[:, c], q))
    index = (np.concatenate(rows), np.concatenate(columns))
    return residual.ravel(), coo_array((np.concatenate(values), index), shape=(n * q, len(x))).tocsc()
