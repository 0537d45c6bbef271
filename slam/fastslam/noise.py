"""A snapshot's measurements as the kernels want them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats
from cellslam.slam.front_end import Readings

Singles = NDArray[np.float32]


def packed(readings: Readings) -> tuple[Singles, Singles]:
    """Return the measurements (m, 13) each: to associate, and to update with.

    Distance, cos and sin of azimuth and of elevation, three variances, three flags: 1 measured, 0 not (then the
    variance is 1); half the log of the ratio of the variances' products: what an update's density lacks against that of
    one measurement; azimuth.
    """
    known = ~np.isnan(readings.z)
    d, az, el = np.nan_to_num(readings.z).T
    directions = (d, np.cos(az), np.sin(az), np.cos(el), np.sin(el))

    def table(variance: Floats) -> Singles:
        columns = (*directions, np.where(known, variance, 1.0), known.astype(float), readings.lack, az)
        return np.ascontiguousarray(np.column_stack(columns), np.float32)

    return table(readings.single), table(readings.many)
