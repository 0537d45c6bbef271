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

from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.misfit_kernel import compare
from cellslam.slam.measurements.readings import Readings

WEIGHT = 15.0  # directions that the expectation counts for at the start


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
        compare(
            answer.pose if pose is None else pose, answer.association, answer.vts.id, answer.vts.position_m,
            answer.vts.covariance, values.z, values.single, self.factor, self._keep, self.sums,
        )  # fmt: skip


def warm_up() -> None:
    """Compile the kernel, or load it from its cache."""
    names = np.zeros(1, np.int64)
    compare(
        np.zeros(6), names, names, np.ones((1, 3)), np.zeros((1, 3, 3)), np.ones((1, 3)), np.ones((1, 3)), np.ones(2),
        1.0, np.ones((2, 2)),
    )  # fmt: skip
