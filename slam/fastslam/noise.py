"""A snapshot's measurements as the kernels want them."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.front_end import Readings


def packed(readings: Readings) -> tuple[Floats, Floats]:
    """Return the measurements (m, 12) each: to associate, and to update with.

    Distance, cos and sin of azimuth and of elevation, three variances, three flags: 1 measured, 0 not (then the
    variance is 1); last, half the log of the ratio of the variances' products: what an update's density lacks against
    that of one measurement.
    """
    known = ~np.isnan(readings.z)
    d, az, el = np.nan_to_num(readings.z).T
    directions = (d, np.cos(az), np.sin(az), np.cos(el), np.sin(el))

    def table(variance: Floats) -> Floats:
        columns = (*directions, np.where(known, variance, 1.0), known.astype(float), readings.lack)
        return np.ascontiguousarray(np.column_stack(columns))

    return table(readings.single), table(readings.many)
