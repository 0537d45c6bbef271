"""Compiled: transmitters as Gaussian mixtures within each particle of the user, weighed by one distance at a time.

A component (19,): weight; pseudo-range s (distance plus clock offset, m), azimuth and elevation (rad, world) as seen
from the anchor, clock offset b (m); the upper triangle of their covariance, by rows; cosine and sine of azimuth and
elevation, which turn with these. The transmitter stands at anchor + (s - b) n(azimuth, elevation): there the first
distance says s, and nothing else, exactly.

Source: Gentner et al. 2016 (see `channel_slam`); a mixture of Gaussians after Alspach and Sorenson, "Nonlinear Bayesian
estimation using Gaussian sum approximations", IEEE Trans. Automatic Control 17(4), 1972.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints

MEAN, COV, TRIG, COMPONENT = 1, 5, 15, 19
DIAGONAL = [COV, COV + 4, COV + 7, COV + 9]
NEAREST_M = 1.0
PEAK = 1.0 / math.sqrt(2.0 * math.pi)
NOTHING = 40.0  # a likelihood so many nats below that of an outlier is none


def face(components: Floats) -> None:
    """Write cosines and sines of the directions (rad) of components (..., 19) beside them."""
    azimuth, elevation = components[..., MEAN + 1], components[..., MEAN + 2]
    trig = (np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation))
    components[..., TRIG:] = np.stack(trig, axis=-1)


@part
def _turn(c: Floats, at: int, angle: float) -> None:
    """Turn the cosine and sine at c[at] by an angle; small ones by the series, whose remainder is below 2e-12."""
    square = angle * angle
    if square < 1e-3:
        cosine = 1.0 - square * (0.5 - square / 24.0)
        sine = angle * (1.0 - square * (1.0 / 6.0 - square / 120.0))
    else:
        cosine, sine = math.cos(angle), math.sin(angle)
    c[at], c[at + 1] = c[at] * cosine - c[at + 1] * sine, c[at + 1] * cosine + c[at] * sine


@part
def _update(
    c: Floats, dx: float, dy: float, dz: float, measured: float, variance: float, floor: float, far: float
) -> float:
    """Kalman update of one component by a distance; return its likelihood: Gaussian and a floor for outliers.

    (dx, dy, dz): anchor - user. h: d(distance)/d(s, azimuth, elevation, b); k: covariance times h.
    """
    rho = max(c[1] - c[4], NEAREST_M)
    ca, sa, ce, se = c[15], c[16], c[17], c[18]
    nx, ny = ce * ca, ce * sa
    x, y, z = dx + rho * nx, dy + rho * ny, dz + rho * se
    r = max(math.sqrt(x * x + y * y + z * z), 1e-3)
    inverse = 1.0 / r
    x, y, z = x * inverse, y * inverse, z * inverse
    h0 = x * nx + y * ny + z * se
    h1 = rho * (y * nx - x * ny)
    h2 = rho * (z * ce - se * (x * ca + y * sa))
    h3 = 1.0 - h0
    k0 = c[5] * h0 + c[6] * h1 + c[7] * h2 + c[8] * h3
    k1 = c[6] * h0 + c[9] * h1 + c[10] * h2 + c[11] * h3
    k2 = c[7] * h0 + c[10] * h1 + c[12] * h2 + c[13] * h3
    k3 = c[8] * h0 + c[11] * h1 + c[13] * h2 + c[14] * h3
    e = measured - r - c[4]
    weight = 1.0 / (variance + k0 * h0 + k1 * h1 + k2 * h2 + k3 * h3)
    distance2 = e * e * weight
    if distance2 > far:
        return floor
    peak = math.exp(-0.5 * distance2) * math.sqrt(weight) * PEAK
    if peak > floor:
        g0, g1, g2, g3 = k0 * weight, k1 * weight, k2 * weight, k3 * weight
        c[1] += g0 * e
        c[2] += g1 * e
        c[3] += g2 * e
        c[4] += g3 * e
        c[5] -= g0 * k0
        c[6] -= g0 * k1
        c[7] -= g0 * k2
        c[8] -= g0 * k3
        c[9] -= g1 * k1
        c[10] -= g1 * k2
        c[11] -= g1 * k3
        c[12] -= g2 * k2
        c[13] -= g2 * k3
        c[14] -= g3 * k3
        _turn(c, TRIG, g1 * e)
        _turn(c, TRIG + 2, g2 * e)
    return peak + floor


@njit(cache=True, parallel=True)
def weigh(
    users: Floats, anchors: Floats, mixture: Floats, counts: Ints, which: Ints, distance_m: Floats, variance: Floats,
    floor: float, least: float, log_weight: Floats,
) -> None:  # fmt: skip
    """Update transmitters `which` (n,) by distances (n,) of variances (n,) in every user particle, and weigh these.

    users (N, 6): poses; anchors (N, J, 3); mixture (N, J, M, 19), counts (N, J): components; floor: density of an
    outlier, 1/m; least: components of less weight are dropped. log_weight (N,) is added to: log-density of the
    distance given all earlier ones (Gentner et al., weights of the Rao-Blackwellised filter).
    """
    far = 2.0 * (NOTHING - math.log(floor)) if floor > 0.0 else np.inf
    for i in prange(len(users)):
        for n in range(len(which)):
            j = which[n]
            dx = anchors[i, j, 0] - users[i, 0]
            dy = anchors[i, j, 1] - users[i, 1]
            dz = anchors[i, j, 2] - users[i, 2]
            total = 0.0
            for m in range(counts[i, j]):
                c = mixture[i, j, m]
                c[0] *= _update(c, dx, dy, dz, distance_m[n], variance[n], floor, far)
                total += c[0]
            log_weight[i] += math.log(total)
            kept = 0
            for m in range(counts[i, j]):
                if mixture[i, j, m, 0] >= least * total:
                    if kept != m:
                        mixture[i, j, kept] = mixture[i, j, m]
                    mixture[i, j, kept, 0] /= total
                    kept += 1
            counts[i, j] = kept


@njit(cache=True)
def describe(anchor: Floats, mixture: Floats, count: int, points: Floats, out: Floats) -> None:
    """Write mean (4,) and covariance (4, 4) of x, y, z and clock offset, in m, over a mixture (M, 19) into out (5, 4).

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


@part
def _accumulate(out: Floats, share: float, x: float, y: float, z: float, b: float) -> None:
    d = (x, y, z, b)
    for r in range(4):
        for c in range(4):
            out[1 + r, c] += share * d[r] * d[c]


@part
def _sigma_points(c: Floats, points: Floats) -> None:
    """Write mean +- 2 columns of the root of the covariance (4, 4) of a component into points (4, 8)."""
    for a in range(4):
        for n in range(8):
            points[a, n] = c[MEAN + a]
    root = np.zeros((4, 4))
    for col in range(4):
        for a in range(col, 4):
            value = c[COV + 4 * col - col * (col - 1) // 2 + a - col]
            for b in range(col):
                value -= root[a, b] * root[col, b]
            if a == col:
                root[a, a] = math.sqrt(max(value, 1e-12))
            else:
                root[a, col] = value / root[col, col]
        for a in range(col, 4):
            points[a, col] += 2.0 * root[a, col]
            points[a, 4 + col] -= 2.0 * root[a, col]
