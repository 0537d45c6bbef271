"""Compiled: the variances with which measurements associate and update."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def count_sharers(z, link, group, q):
    """Return for each measurement (m,) how many links of its group measured the same path, its own included.

    z (m, 3): distance, azimuth, elevation, NaN where not measured; q (m, 3): their variances; group (m,).
    """
    count = np.ones(len(link))
    for i in range(len(link)):
        for j in range(i):
            if group[i] != group[j] or link[i] == link[j]:
                continue
            same = True
            for c in range(3):
                gap = z[i, c] - z[j, c]
                if c == 1:
                    gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
                same = same and not gap * gap > 9.0 * (q[i, c] + q[j, c])
            if same:
                count[i] += 1.0
                count[j] += 1.0
    return count


@njit(cache=True)
def combine(z, white, place, direction, by_place, by_direction, link, site_of, port_of):
    """Return variances (m, 3) of single measurements, of updates and of births, and (m,) what an update's log-density
    lacks.

    white (m, 3): white variances; place, direction (3,): those of errors that persist, each met in by_place,
    by_direction (3,) snapshots, and by all links (L,) of a port or of a site that see the same path.
    """
    m = len(link)
    single, many, fresh, lack = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3)), np.zeros(m)
    for i in range(m):
        for c in range(3):
            single[i, c] = max(white[i, c] + place[c] + direction[c], 1e-12)
    port, site = count_sharers(z, link, port_of[link], single), count_sharers(z, link, site_of[link], single)
    for i in range(m):
        for c in range(3):
            q = white[i, c] + place[c] * by_place[c] * port[i] + direction[c] * by_direction[c] * site[i]
            many[i, c] = max(q, 1e-12)
            fresh[i, c] = max(white[i, c] + place[c] * port[i] + direction[c] * site[i], 1e-12)
            if not math.isnan(z[i, c]):
                lack[i] += 0.5 * math.log(many[i, c] / single[i, c])
    return single, many, fresh, lack
