"""Directions that are worse than the front end is known for: measured during the drive, and taken into account.

Where paths come close together, as in a street canyon, the front end takes two for one, and their directions err by
twice what its noise model says. Each snapshot's directions are held against the VTs that are known well; where they
have lately been worse than expected on the whole, all variances are raised by as much: an adaptive Kalman filter by
innovation matching. Never lowered: errors that persist are in the VTs too, and do not show.

Source: Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5), 1972 (covariance matching).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cellslam.sim.frames import azimuth_elevation, rotation, wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings import Readings

WEIGHT = 15.0  # directions that the expectation counts for at the start
MOST = 9.0  # the most that a squared error over its variance counts
LEAST_FLAT = 0.2  # a VT higher, flat part over range, says nothing
TINY = 1e-9  # m


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

        `pose` (6,) in m and rad: from where the answer's VTs were seen, where that is not its pose. A VT that is known
        no better than one measurement says nothing.
        """
        if self._scale_s == 0.0 or answer.association is None or answer.vts is None or not len(answer.association):
            return
        pose, row = answer.pose if pose is None else pose, rows_of(answer.association, answer.vts.id)
        there = row >= 0
        to_vt, spread = answer.vts.position_m[row[there]] - pose[:3], answer.vts.covariance[row[there]]
        full, flat = np.linalg.norm(to_vt, axis=1), np.maximum(np.hypot(to_vt[:, 0], to_vt[:, 1]), TINY)
        (ex, ny, _), rise, zero = to_vt.T / flat, to_vt[:, 2] / full, np.zeros(len(flat))
        # Across the path, level and upwards: along these a VT's place changes its azimuth and its elevation.
        axis = np.array([[-ny, ex, zero], [-rise * ex, -rise * ny, flat / full]])
        known = np.einsum("cin,nij,cjn->nc", axis, spread, axis) / np.stack([flat, full], axis=1) ** 2
        seen = azimuth_elevation(to_vt @ rotation(pose[3], 0.0, 0.0))
        error, expected = (
            wrap_angle(values.z[there, 1:] - np.stack(seen, axis=1)),
            values.single[there, 1:] / self.factor,
        )
        tells = (known < expected) & np.isfinite(error) & (flat >= LEAST_FLAT * full)[:, None]
        squares = np.where(tells, np.minimum(error**2 / expected, MOST), 0.0)
        self.sums = self._keep * self.sums + np.stack([squares.sum(axis=0), tells.sum(axis=0)], axis=1)


def rows_of(association: Ints, ident: Ints) -> Ints:
    """Return the row (m,) of the VT of each measurement among VTs (V,), by their identities; -1 where it has none."""
    if not len(ident):
        return np.full(len(association), -1)
    order = np.argsort(ident)
    row = order[np.minimum(np.searchsorted(ident, association, sorter=order), len(ident) - 1)]
    return np.where((association >= 0) & (ident[row] == association), row, -1)
