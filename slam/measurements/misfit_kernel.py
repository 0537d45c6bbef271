"""Compiled: how large the errors of directions are against what was expected.

Source: Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5), 1972 (covariance matching).
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints

MOST = 9.0  # a squared error over its variance counts at most so much
LEAST_FLAT = 0.2  # a VT higher than this share of its range says nothing of azimuth


@njit(cache=True)
def compare(
    pose: Floats,
    association: Ints,
    names: Ints,
    vts: Floats,
    spreads: Floats,
    z: Floats,
    single: Floats,
    factor: Floats,
    keep: float,
    sums: Floats,
) -> None:
    """Update sums (2, 2): of azimuth and of elevation the squared errors over their variances, and how many, after
    `keep` of what they were.

    Measurement i of z (m, 3), in m and rad, with variances `single` (m, 3) that hold `factor` (2,), is of the VT that
    is called association[i], with its place in `names` (V,) a row of `vts` (V, 3) and `spreads` (V, 3, 3); seen from
    `pose` (6,), level. A VT that is known no better than one measurement says nothing.
    """
    for c in range(2):
        sums[c, 0] *= keep
        sums[c, 1] *= keep
    cp, sp = math.cos(pose[3]), math.sin(pose[3])
    for i in range(len(association)):
        which = -1
        for n in range(len(names)):
            if names[n] == association[i] and association[i] >= 0:
                which = n
        if which < 0:
            continue
        s = spreads[which]
        east, north, up = vts[which, 0] - pose[0], vts[which, 1] - pose[1], vts[which, 2] - pose[2]
        flat = math.hypot(east, north)
        full = math.hypot(flat, up)
        if flat < LEAST_FLAT * full:
            continue
        ex, ny, rise, level = east / flat, north / flat, up / full, flat / full
        ahead, left = cp * east + sp * north, cp * north - sp * east
        along = ex * ex * s[0, 0] + 2.0 * ex * ny * s[0, 1] + ny * ny * s[1, 1]
        across = ny * ny * s[0, 0] - 2.0 * ex * ny * s[0, 1] + ex * ex * s[1, 1]
        tilted = rise * rise * along - 2.0 * rise * level * (ex * s[0, 2] + ny * s[1, 2]) + level * level * s[2, 2]
        for c in range(2):
            if math.isnan(z[i, 1 + c]):
                continue
            if c == 0:
                error, known = z[i, 1] - math.atan2(left, ahead), across / (flat * flat)
                error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
            else:
                error, known = z[i, 2] - math.atan2(up, flat), tilted / (full * full)
            expected = single[i, 1 + c] / factor[c]
            if known < expected:
                sums[c, 0] += min(error * error / expected, MOST)
                sums[c, 1] += 1.0
