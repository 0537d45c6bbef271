"""Directions that are worse than the front end is known for: measured during the drive, and taken into account.

Where paths come close together, as in a street canyon, the front end takes two for one, and their directions err by
twice what its noise model says. Each snapshot's directions are held against the VTs that are known well; where they
have lately been worse than expected on the whole, all variances are raised by as much: an adaptive Kalman filter by
innovation matching. Never lowered: errors that persist are in the VTs too, and do not show.

Source: Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5), 1972.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings import Readings

WEIGHT = 15.0  # directions that the expectation counts for at the start
MOST = 9.0  # a squared error over its variance counts at most so much
LEAST_FLAT = 0.2  # a VT higher than this share of its range says nothing of azimuth


class Misfit:
    """Squared errors over their variances, of azimuth and elevation, as lately seen, and how many: `sums` (2, 2)."""

    def __init__(self, options: MeasurementOptions) -> None:
        """Begin with what is expected."""
        self._scale_s = options.misfit_scale_s
        self.sums = np.full((2, 2), WEIGHT)
        self.factor: Floats = np.ones(2)
        self._keep = 1.0

    def widened(self, values: Readings, dt_s: float) -> Readings:
        """Return measurements, `dt_s` after the last ones, with their variances raised as needed."""
        if self._scale_s == 0.0:
            return values
        self._keep = math.exp(-dt_s / self._scale_s)
        self.factor = np.maximum(self.sums[:, 0] / self.sums[:, 1], 1.0)
        by = np.array([1.0, *self.factor])
        return replace(values, single=values.single * by, many=values.many * by, fresh=values.fresh * by)

    def learn(self, answer: Estimate, values: Readings, pose: Floats | None = None) -> None:
        """Compare measurements with the answer to them.

        `pose` (6,) in m and rad: from where the answer's VTs were seen, where that is not its pose.
        """
        if self._scale_s == 0.0 or answer.association is None or answer.vts is None or not len(answer.association):
            return
        _compare(
            answer.pose if pose is None else pose, answer.association, answer.vts.id, answer.vts.position_m,
            answer.vts.covariance, values.z, values.single, self.factor, self._keep, self.sums,
        )  # fmt: skip


def warm_up() -> None:
    """Compile the kernel, or load it from its cache."""
    names = np.zeros(1, np.int64)
    _compare(
        np.zeros(6), names, names, np.ones((1, 3)), np.zeros((1, 3, 3)), np.ones((1, 3)), np.ones((1, 3)), np.ones(2),
        1.0, np.ones((2, 2)),
    )  # fmt: skip


@njit(cache=True)
def _compare(
    pose: Floats, association: Ints, names: Ints, vts: Floats, spreads: Floats, z: Floats, single: Floats,
    factor: Floats, keep: float, sums: Floats,
) -> None:  # fmt: skip
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
