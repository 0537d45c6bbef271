"""Compiled: a snapshot's measurements as the kernels want them.

Source: paper, eq. 7 and 32: components of a measurement, and the constants of its log-density.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints

COLUMNS = 15
# A VT that is born without a component begins as wide as this about a place of its own in each particle.
UNKNOWN_RANGE, UNKNOWN_AZIMUTH_RAD, UNKNOWN_ELEVATION_RAD = 0.4, 0.5, 0.2
# Distances that are tried where only angles are measured, evenly in their logarithm, m.
LEAST_RANGE_M, MOST_RANGE_M = 3.0, 600.0


@njit(cache=True)
def pack(
    z: Floats, single: Floats, many: Floats, fresh: Floats, gap: Floats, lack: Floats, begins: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return three tables (m, 15) in single precision: to associate with, to update with, to give birth with.

    Columns: distance (m), cos and sin of azimuth and of elevation, three variances, three flags: 1 measured, 0 not
    (then the variance is 1); what the log-density lacks: in both that of components that were not measured, against
    clutter of width `gap`, in the second `lack` too, since it is that of an update; azimuth (rad); 6 standard
    deviations of distance and of azimuth. What may not begin a VT (begins (m,)) has neither distance nor azimuth in the
    third. Other arguments: see `readings.Readings`.
    """
    m = len(z)
    shape = (m, COLUMNS)
    first, second, third = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    for i in range(m):
        row = first[i]
        missing = 0.0
        for c in range(3):
            known = not math.isnan(z[i, c])
            missing += 0.0 if known else 0.5 * math.log(2.0 * math.pi)
            row[8 + c] = 1.0 if known else 0.0
            row[5 + c] = single[i, c] if known else 1.0
        azimuth = z[i, 1] if row[9] > 0.0 else 0.0
        elevation = z[i, 2] if row[10] > 0.0 else 0.0
        row[0] = z[i, 0] if row[8] > 0.0 else 0.0
        row[1], row[2] = math.cos(azimuth), math.sin(azimuth)
        row[3], row[4] = math.cos(elevation), math.sin(elevation)
        row[11] = missing - gap[i]
        row[12] = azimuth
        row[13], row[14] = 6.0 * math.sqrt(row[5]), 6.0 * math.sqrt(row[6])
        second[i], third[i] = row, row
        third[i, 5], third[i, 6], third[i, 7] = UNKNOWN_RANGE**2, UNKNOWN_AZIMUTH_RAD**2, UNKNOWN_ELEVATION_RAD**2
        for c in range(3):
            if row[8 + c] > 0.0:
                second[i, 5 + c], third[i, 5 + c] = many[i, c], fresh[i, c]
        second[i, 11] += lack[i]
        if not begins[i]:
            third[i, 8], third[i, 9] = 0.0, 0.0
    return first, second, third


@njit(cache=True)
def census(link: Ints, counts: Ints) -> tuple[Ints, int, int]:
    """Return the first measurement of each link (L + 1,), how many a link has at most, and how many tracks a map of
    counts (G, L) could have when each measurement has begun one. link (m,): of each measurement, sorted."""
    links = counts.shape[1]
    first = np.zeros(links + 1, np.int64)
    for i in range(len(link)):
        first[link[i] + 1] += 1
    most, needed = first.max(), 0
    for g in range(counts.shape[0]):
        for i in range(links):
            needed = max(needed, counts[g, i] + first[i + 1])
    for i in range(links):
        first[i + 1] += first[i]
    return first, most, needed


@njit(cache=True)
def evenly(particle: int, birth: int, sequence: int) -> float:
    """Return a number in [0, 1): over particles and over births evenly spread (additive recurrences)."""
    step = 0.6180339887498949 if sequence == 0 else 0.4142135623730950
    value = step * particle + 0.7548776662466927 * birth
    return value - math.floor(value)
