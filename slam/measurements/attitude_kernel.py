"""Compiled: directions turned into the level frame, and what a snapshot's directions say of pitch and roll.

Source: Gelb, "Applied optimal estimation", 1974, chapters 3 (Gauss-Markov process) and 4 (update in information form),
with the azimuth and elevation of the paper, eq. 25 to 27.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints

GATE = 4.0  # deviations beyond which a direction says nothing
TINY = 1e-12


@njit(cache=True)
def level(
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
def observe(
    mean: Floats,
    covariance: Floats,
    pose: Floats,
    association: Ints,
    names: Ints,
    vts: Floats,
    spreads: Floats,
    azimuth: Floats,
    elevation: Floats,
    variance: Floats,
    common: Floats,
) -> None:
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
        # Level to body: the inverse of `level`.
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
