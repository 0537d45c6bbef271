"""Compiled: which measurements of different links are of one path, and their means.

Sources: Bar-Shalom and Li, "Multitarget-multisensor tracking", 1995 (normalised distance, nearest neighbour); the
variance of a weighted mean.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints

TOGETHER = 16.3  # squared distance of two measurements of one path over its variance, at most


@njit(cache=True)
def taken_together(
    distance: Floats,
    azimuth: Floats,
    elevation: Floats,
    white: Floats,
    place: Floats,
    link: Ints,
    group_of: Ints,
    port_of: Ints,
    together: bool,
) -> tuple[Floats, Floats, Ints, Ints, Ints, Ints, Ints]:
    """Return the n fused measurements of m measurements, sorted by group: their values (n, 3), white variances (n, 3),
    group (n,), number of members (n,) and of ports (n,), and first member (n,); and which of them each measurement is a
    member of (m,).

    distance (m,) in m, azimuth and elevation (m,) in rad; white (m, 3): variances; place (3,): those of errors that
    differ from port to port; link (m,), sorted; group_of, port_of (L,). Where `together` is false, each measurement is
    fused with no other.
    """
    m = len(link)
    z = np.empty((m, 3))
    for i in range(m):
        z[i, 0], z[i, 1], z[i, 2] = distance[i], azimuth[i], elevation[i]
    if together:
        fused_of, fused = group(z, white + 2.0 * place, link, group_of)
    else:
        fused_of, fused = np.arange(m), m
    lead, count = np.full(fused, -1), np.zeros(len(group_of) + 1, np.int64)
    for i in range(m):
        if lead[fused_of[i]] < 0:
            lead[fused_of[i]] = i
            count[group_of[link[i]] + 1] += 1
    count = np.cumsum(count)
    first, own = np.empty(fused, np.int64), np.empty(fused, np.int64)
    number = np.empty(fused, np.int64)
    for n in range(fused):
        g = group_of[link[lead[n]]]
        number[n] = count[g]
        own[count[g]], first[count[g]] = g, lead[n]
        count[g] += 1
    for i in range(m):
        fused_of[i] = number[fused_of[i]]
    mean, variance, members, ports = means(z, white, link, port_of, fused_of, first)
    return mean, variance, own, members, ports, first, fused_of


@part
def group(z: Floats, variance: Floats, link: Ints, group_of: Ints) -> tuple[Ints, int]:
    """Return which fused measurement each measurement is a member of (m,), and how many fused ones there are.

    z (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured; variance (m, 3): of each, without what
    all measurements of a path have in common; link (m,): sorted; group_of (L,): links of one group see the same paths,
    a path at most once each. A fused measurement is where its members are in the mean. Of all pairs of a measurement of
    a link and a fused measurement, the closest is joined first.
    """
    m = len(link)
    fused_of, own, taken = np.empty(m, np.int64), np.empty(m, np.int64), np.zeros(m, np.int64)
    centre, spread, members = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3))
    fused, start = 0, 0
    while start < m:
        stop = start
        while stop < m and link[stop] == link[start]:
            fused_of[stop] = -1
            stop += 1
        before = fused
        taken[:before] = 0
        while True:
            best, which, where = TOGETHER, -1, -1
            for k in range(start, stop):
                if fused_of[k] >= 0:
                    continue
                for c in range(before):
                    if taken[c] == 1 or own[c] != group_of[link[start]]:
                        continue
                    apart = _apart(z[k], variance[k], centre[c], spread[c])
                    if apart < best:
                        best, which, where = apart, k, c
            if which < 0:
                break
            fused_of[which], taken[where] = where, 1
            _join(z[which], variance[which], centre[where], spread[where], members[where])
        for k in range(start, stop):
            if fused_of[k] < 0:
                fused_of[k], own[fused] = fused, group_of[link[start]]
                _join(z[k], variance[k], centre[fused], spread[fused], members[fused])
                fused += 1
        start = stop
    return fused_of, fused


@part
def means(
    z: Floats, white: Floats, link: Ints, port_of: Ints, fused_of: Ints, first: Ints
) -> tuple[Floats, Floats, Ints, Ints]:
    """Return the n fused measurements of measurements z (m, 3): means (n, 3) of their members, white variances (n, 3),
    number of members (n,) and of ports (n,).

    The measurements of one port count alike, and ports count alike. link (m,); fused_of (m,): the fused
    measurement of each; port_of (L,); first (n,): one member of each fused measurement.
    """
    m, fused = len(link), len(first)
    mean, variance, whole = np.zeros((fused, 3)), np.zeros((fused, 3)), np.zeros((fused, 3))
    members, ports = np.zeros(fused, np.int64), np.zeros(fused, np.int64)
    for i in range(m):
        n, alike, before = fused_of[i], 0, 0
        for j in range(m):
            if fused_of[j] == n and port_of[link[j]] == port_of[link[i]]:
                alike += 1
                before += 1 if j < i else 0
        members[n] += 1
        ports[n] += 1 if before == 0 else 0
        weight = 1.0 / alike
        for c in range(3):
            if math.isnan(z[i, c]):
                continue
            gap = z[i, c]
            if c == 1 and not math.isnan(z[first[n], 1]):
                gap -= z[first[n], 1]
                gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
            mean[n, c] += weight * gap
            variance[n, c] += weight * weight * white[i, c]
            whole[n, c] += weight
    for n in range(fused):
        for c in range(3):
            if whole[n, c] == 0.0:
                mean[n, c], variance[n, c] = math.nan, white[first[n], c]
                continue
            mean[n, c] /= whole[n, c]
            variance[n, c] /= whole[n, c] * whole[n, c]
        if not math.isnan(z[first[n], 1]):
            mean[n, 1] += z[first[n], 1]
    return mean, variance, members, ports


@part
def _apart(z: Floats, variance: Floats, centre: Floats, spread: Floats) -> float:
    """Return the squared distance of a measurement from a fused one, over its variance."""
    total = 0.0
    for c in range(3):
        gap = z[c] - centre[c]
        if math.isnan(gap):
            continue
        if c == 1:
            gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
        total += gap * gap / (variance[c] + spread[c])
    return total


@part
def _join(z: Floats, variance: Floats, centre: Floats, spread: Floats, members: Floats) -> None:
    """Take a measurement into the mean of a fused one, which begins with the first that has a component."""
    for c in range(3):
        if members[c] == 0.0:
            centre[c], spread[c] = z[c], variance[c]
        if math.isnan(z[c]):
            continue
        members[c] += 1.0
        gap = z[c] - centre[c]
        if c == 1:
            gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
        centre[c] += gap / members[c]
        spread[c] += (variance[c] - spread[c]) / members[c]
