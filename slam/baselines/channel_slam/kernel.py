"""Compiled: transmitters as Gaussian mixtures within each particle of the user, weighed by one distance at a time.

A component (21,): weight; pseudo-range s (distance plus clock offset, m), azimuth and elevation (rad, world) as seen
from the anchor, clock offset b (m); their covariance (4 x 4). The transmitter stands at anchor + (s - b) n(azimuth,
elevation): there the first distance says s, and nothing else, exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

MEAN, COV, COMPONENT = 1, 5, 21
NEAREST_M = 1.0


@njit(cache=True)
def _predict(c, dx, dy, dz, h):
    """Write d(distance)/d(s, azimuth, elevation, b) into h (4,); return the distance; (dx, dy, dz): anchor - user."""
    rho = max(c[MEAN] - c[MEAN + 3], NEAREST_M)
    ca, sa = math.cos(c[MEAN + 1]), math.sin(c[MEAN + 1])
    ce, se = math.cos(c[MEAN + 2]), math.sin(c[MEAN + 2])
    nx, ny = ce * ca, ce * sa
    x, y, z = dx + rho * nx, dy + rho * ny, dz + rho * se
    r = max(math.sqrt(x * x + y * y + z * z), 1e-3)
    x, y, z = x / r, y / r, z / r
    h[0] = x * nx + y * ny + z * se
    h[1] = rho * (-x * ny + y * nx)
    h[2] = rho * (-x * se * ca - y * se * sa + z * ce)
    h[3] = 1.0 - h[0]
    return r + c[MEAN + 3]


@njit(cache=True)
def _update(c, dx, dy, dz, measured, variance, floor, h, k):
    """Kalman update of one component by a distance; return its likelihood: Gaussian and a floor for outliers."""
    e = measured - _predict(c, dx, dy, dz, h)
    s = variance
    for a in range(4):
        k[a] = 0.0
        for b in range(4):
            k[a] += c[COV + 4 * a + b] * h[b]
        s += k[a] * h[a]
    peak = math.exp(-0.5 * e * e / s) / math.sqrt(2.0 * math.pi * s)
    if peak > floor:
        for a in range(4):
            c[MEAN + a] += k[a] / s * e
            for b in range(4):
                c[COV + 4 * a + b] -= k[a] * k[b] / s
    return peak + floor


@njit(cache=True, parallel=True)
def weigh(users, anchors, mixture, counts, which, distance_m, variance, floor, least, log_weight, scratch):
    """Update transmitters `which` (n,) by distances (n,) of variances (n,) in every user particle, and weigh these.

    users (N, 6): poses; anchors (N, J, 3); mixture (N, J, M, 21), counts (N, J): components; floor: density of an
    outlier, 1/m; least: components of less weight are dropped. log_weight (N,) is added to: log-density of the
    distance given all earlier ones (Gentner et al., weights of the Rao-Blackwellised filter). scratch (N, 8).
    """
    for i in prange(len(users)):
        h, k = scratch[i, :4], scratch[i, 4:]
        for n in range(len(which)):
            j = which[n]
            dx = anchors[i, j, 0] - users[i, 0]
            dy = anchors[i, j, 1] - users[i, 1]
            dz = anchors[i, j, 2] - users[i, 2]
            total = 0.0
            for m in range(counts[i, j]):
                c = mixture[i, j, m]
                c[0] *= _update(c, dx, dy, dz, distance_m[n], variance[n], floor, h, k)
                total += c[0]
            log_weight[i] += math.log(total)
            kept = 0
            for m in range(counts[i, j]):
                if mixture[i, j, m, 0] >= least * total:
                    for a in range(COMPONENT):
                        mixture[i, j, kept, a] = mixture[i, j, m, a]
                    mixture[i, j, kept, 0] /= total
                    kept += 1
            counts[i, j] = kept


@njit(cache=True)
def describe(anchor, mixture, count, points, out):
    """Write mean (4,) and covariance (4, 4) of x, y, z and clock offset over a mixture (M, 21) into out (5, 4).

    Each component is represented by eight sigma points of its four coordinates; points (4, 8): scratch.
    """
    for a in range(5):
        for b in range(4):
            out[a, b] = 0.0
    total = 0.0
    for m in range(count):
        total += mixture[m, 0]
    for step in range(2):
        for m in range(count):
            c = mixture[m]
            _sigma_points(c, points)
            share = c[0] / total / 8.0
            for n in range(8):
                rho = max(points[0, n] - points[3, n], NEAREST_M)
                ce = math.cos(points[2, n])
                x = anchor[0] + rho * ce * math.cos(points[1, n])
                y = anchor[1] + rho * ce * math.sin(points[1, n])
                z, b = anchor[2] + rho * math.sin(points[2, n]), points[3, n]
                if step == 0:
                    out[0, 0] += share * x
                    out[0, 1] += share * y
                    out[0, 2] += share * z
                    out[0, 3] += share * b
                else:
                    _accumulate(out, share, x - out[0, 0], y - out[0, 1], z - out[0, 2], b - out[0, 3])


@njit(cache=True)
def _accumulate(out, share, x, y, z, b):
    d = (x, y, z, b)
    for r in range(4):
        for c in range(4):
            out[1 + r, c] += share * d[r] * d[c]


@njit(cache=True)
def _sigma_points(c, points):
    """Write mean +- 2 columns of the root of the covariance (4, 4) of a component into points (4, 8)."""
    for a in range(4):
        for n in range(8):
            points[a, n] = c[MEAN + a]
    root = np.zeros((4, 4))
    for col in range(4):
        for a in range(col, 4):
            value = c[COV + 4 * a + col]
            for b in range(col):
                value -= root[a, b] * root[col, b]
            if a == col:
                root[a, a] = math.sqrt(max(value, 1e-12))
            else:
                root[a, col] = value / root[col, col]
        for a in range(col, 4):
            points[a, col] += 2.0 * root[a, col]
            points[a, 4 + col] -= 2.0 * root[a, col]
