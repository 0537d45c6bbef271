"""Pitch and roll of a vehicle whose odometry does not see them: followed from one snapshot to the next.

Acceleration, turns and the road tilt the array by tenths of a degree for seconds. Twenty directions at once, most of
landmarks that are well known, tell by how much; what the next snapshot measures is then turned into the level frame.
The attitude is a first-order Gauss-Markov process; an error that all directions have in common is left out.

Source: Gelb, "Applied optimal estimation", 1974, chapters 3 (Gauss-Markov process) and 4 (Kalman filter, in information
form), with the azimuth and elevation of the paper, eq. 25 to 27.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.measurements.measurement_options import MeasurementOptions

GATE = 4.0  # deviations beyond which a direction says nothing
TINY = 1e-12

Seen = TypeVar("Seen", bound=Snapshot)


class Attitude:
    """Belief on pitch and roll: `mean` (2,) in rad, `covariance` (2, 2)."""

    def __init__(self, options: MeasurementOptions, setup: Setup) -> None:
        """Begin level. What the odometry or the start says of pitch and roll belongs to the pose: then this is off."""
        model = setup.odometry_model
        seen = np.concatenate([model.noise_density[4:], model.bias[4:], setup.start_std[4:], setup.start_pose[4:]])
        self.prior = np.radians([options.pitch_deg, options.roll_deg]) ** 2
        self.on = bool((self.prior > 0.0).all()) and not seen.any()
        self.options, self.mean, self.covariance = options, np.zeros(2), np.diag(self.prior)

    def levelled(self, dt_s: float, snapshot: Seen) -> Seen:
        """Return a snapshot's measurements as a level array would have made them, `dt_s` after the last ones."""
        if not self.on:
            return snapshot
        left = math.exp(-dt_s / self.options.attitude_scale_s)
        azimuth, elevation = _level(
            self.mean, self.covariance, self.prior, left, snapshot.azimuth_rad, snapshot.elevation_rad
        )
        return replace(snapshot, azimuth_rad=azimuth, elevation_rad=elevation)

    def concluded(self, answer: Estimate, snapshot: Snapshot, variance: Floats, pose: Floats | None = None) -> Estimate:
        """Learn from a snapshot's measurements as they were made, and return the answer to them with pitch and roll.

        `variance` (m, 3): those with which an update counts for what it is worth. `pose` (6,): from where the answer's
        VTs were seen, where that is not its pose.
        """
        if not self.on:
            return answer
        if len(snapshot) and answer.association is not None and answer.vts is not None and len(answer.vts.id):
            vts, place = answer.vts, self.options.persisting[0]
            _observe(
                self.mean, self.covariance, answer.pose if pose is None else pose, answer.association, vts.id,
                vts.position_m, vts.covariance, snapshot.azimuth_rad, snapshot.elevation_rad, variance, place,
            )  # fmt: skip
        mean, covariance = answer.pose.copy(), answer.covariance.copy()
        mean[4:], covariance[4:, 4:] = self.mean, self.covariance
        return replace(answer, pose=mean, covariance=covariance)


def warm_up() -> None:
    """Compile the kernels, or load them from their cache."""
    one = np.zeros(1)
    _level(np.zeros(2), np.eye(2), np.ones(2), 1.0, one, one)
    names = np.zeros(1, np.int64)
    _observe(
        np.zeros(2), np.eye(2), np.zeros(6), names, names, np.ones((1, 3)), np.zeros((1, 3, 3)), one, one,
        np.ones((1, 3)), np.ones(3),
    )  # fmt: skip


@njit(cache=True)
def _level(
    mean: Floats, covariance: Floats, prior: Floats, left: float, azimuth: Floats, elevation: Floats
) -> tuple[Floats, Floats]:
    """Let pitch and roll decorrelate until `left` of the old is in the new; return directions as a level array would
    measure them.

    mean (2,) in rad and covariance (2, 2), written; prior (2,): variances; azimuth, elevation (m,) in rad, as returned.
    Ry(pitch) Rx(roll) takes body to level. NaN where either is missing stays as measured.
    """
    for r in range(2):
        mean[r] *= left
        for c in range(2):
            covariance[r, c] = left * left * covariance[r, c] + ((1.0 - left * left) * prior[r] if r == c else 0.0)
    out_azimuth, out_elevation = np.empty(len(azimuth)), np.empty(len(azimuth))
    ct, st, cr, sr = math.cos(mean[0]), math.sin(mean[0]), math.cos(mean[1]), math.sin(mean[1])
    for i in range(len(azimuth)):
        out_azimuth[i], out_elevation[i] = azimuth[i], elevation[i]
        if math.isnan(azimuth[i]) or math.isnan(elevation[i]):
            continue
        ce = math.cos(elevation[i])
        x, y, z = ce * math.cos(azimuth[i]), ce * math.sin(azimuth[i]), math.sin(elevation[i])
        y, z = cr * y - sr * z, sr * y + cr * z
        x, z = ct * x + st * z, ct * z - st * x
        out_azimuth[i], out_elevation[i] = math.atan2(y, x), math.asin(min(max(z, -1.0), 1.0))
    return out_azimuth, out_elevation


@part
def _row_of(name: int, names: Ints) -> int:
    """Return where `name` is among names (V,), -1 where it is not."""
    for i in range(len(names)):
        if names[i] == name:
            return i
    return -1


@njit(cache=True)
def _observe(
    mean: Floats, covariance: Floats, pose: Floats, association: Ints, names: Ints, vts: Floats, spreads: Floats,
    azimuth: Floats, elevation: Floats, variance: Floats, common: Floats,
) -> None:  # fmt: skip
    """Update mean (2,) and covariance (2, 2) of pitch and roll, in rad, by the directions of known VTs, in place.

    `pose` (6,): place and yaw of the array; measurement i is of the VT that is called association[i], with its place in
    `names` (V,) a row of `vts` (V, 3) and `spreads` (V, 3, 3); `variance` (m, 3) of distance, azimuth, elevation;
    `common` (3,): that of an error that all measurements of the snapshot have in common.
    """
    ct, st, cr, sr = math.cos(mean[0]), math.sin(mean[0]), math.cos(mean[1]), math.sin(mean[1])
    cp, sp = math.cos(pose[3]), math.sin(pose[3])
    # Pitch, roll, and the errors of azimuth and elevation in common.
    information, score = np.zeros((4, 4)), np.zeros(4)
    determinant = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
    information[0, 0], information[1, 1] = covariance[1, 1] / determinant, covariance[0, 0] / determinant
    information[0, 1] = information[1, 0] = -covariance[0, 1] / determinant
    information[2, 2], information[3, 3] = 1.0 / (common[1] + TINY), 1.0 / (common[2] + TINY)
    row, axis = np.empty(4), np.empty(3)
    for i in range(len(association)):
        which = _row_of(association[i], names) if association[i] >= 0 else -1
        if which < 0 or math.isnan(azimuth[i]) or math.isnan(elevation[i]):
            continue
        vt, spread = vts[which], spreads[which]
        east, north, up = vt[0] - pose[0], vt[1] - pose[1], vt[2] - pose[2]
        ahead, left = cp * east + sp * north, cp * north - sp * east
        reach = math.sqrt(ahead * ahead + left * left + up * up)
        # Level to body: the inverse of `_level`.
        x, z = ct * ahead - st * up, st * ahead + ct * up
        y, z = cr * left + sr * z, cr * z - sr * left
        flat = math.hypot(x, y)
        if flat < 0.1 * reach:
            continue
        ca, sa, slope = x / flat, y / flat, z / flat
        for c in range(2):
            if c == 0:
                error = azimuth[i] - math.atan2(y, x)
                error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
                row[0], row[1], row[2], row[3] = slope * sa, slope * ca, 1.0, 0.0
                lx, ly, lz = -sa, ca, 0.0
            else:
                error = elevation[i] - math.atan2(z, flat)
                row[0], row[1], row[2], row[3] = ca, -sa, 0.0, 1.0
                lx, ly, lz = -ca * z / reach, -sa * z / reach, flat / reach
            axis[0], axis[1], axis[2] = cp * lx - sp * ly, sp * lx + cp * ly, lz
            loose = 0.0
            for r in range(3):
                for k in range(3):
                    loose += axis[r] * spread[r, k] * axis[k]
            wide = variance[i, 1 + c] + TINY + loose / max(flat if c == 0 else reach, 1.0) ** 2
            if error * error > GATE * GATE * (wide + common[1 + c] + covariance[0, 0] + covariance[1, 1]):
                continue
            for r in range(4):
                score[r] += row[r] * error / wide
                for k in range(4):
                    information[r, k] += row[r] * row[k] / wide
    inverse = np.linalg.inv(information)
    for r in range(2):
        for k in range(4):
            mean[r] += inverse[r, k] * score[k]
        for k in range(2):
            covariance[r, k] = inverse[r, k]
