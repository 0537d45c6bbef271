"""Compiled maximum-likelihood fit of paths: normal equations with the weights eliminated, Levenberg-Marquardt.

`path_estimator` has the equations. Every column of A and D is an array vector times a tone vector (Kronecker), so that
their Gram matrices are products, element by element, of two small ones.

Samples are correlated with the tones of every searched distance once. With those of a distance d between them, they are

    r(d) = sum_j c_j(d) r(d_j) over the STENCIL distances d_j nearest to d

for the tones of d are the sum of those of the d_j in shares c_j(d), up to 2e-6 of their size: distances are searched in
steps of less than half the resolution. Shares are polynomials in the way between two searched distances.

Source: RIMAX, Richter, "Estimation of radio channel parameters: models and algorithms", 2005; weights eliminated by
variable projection, Golub and Pereyra 1973, in the form of Kaufman 1975.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.signal.path_estimator import thresholds
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import ANY_ORDER, SteeringModel, steer, write_phasors

STENCIL, DEGREE = 12, 7
MARGIN = STENCIL // 2  # searched distances beyond the window on either side


class Normal(NamedTuple):
    """A fit at given geometry: `explained` energy, weights (n, 2), `wald` (n,) energy that each path alone explains,
    `information` (3 n, 3 n) and `gradient` (3 n,) of distance, azimuth, elevation, the weights being eliminated.
    """

    explained: float
    weights: Array
    wald: Array
    information: Array
    gradient: Array


NO_NORMAL = Normal(0.0, np.empty((0, 2), np.complex128), np.empty(0), np.empty((0, 0)), np.empty(0))  # no path


class DelayGrid(NamedTuple):
    """Distances (D,) in m, in even steps, with whose tones the samples of each port are correlated. `shares` (DEGREE +
    1, STENCIL): for the correlation between the two in the middle of a stencil, by powers of the way, -1 to 1. `alike`
    (2 D - 1,): what a unit vector of tones has of that which is so many steps farther, from -D + 1 steps on.
    `coarser`: resolution in distance over that of 100 resource blocks of LTE.
    """

    distances: Array
    shares: Array
    alike: Array
    coarser: float


@part
def in_pairs(columns: Array, like: Array) -> tuple[Array, Array]:
    """Return complex `columns` (n, c), and j times these, as (n, 2 c) real and imaginary parts in turn, of the type of
    `like`.
    """
    n, width = columns.shape
    straight, turned = np.empty((n, 2 * width), like.dtype), np.empty((n, 2 * width), like.dtype)
    for p in range(n):
        for j in range(width):
            real, imaginary = columns[p, j].real, columns[p, j].imag
            straight[p, 2 * j], straight[p, 2 * j + 1] = real, imaginary
            turned[p, 2 * j], turned[p, 2 * j + 1] = -imaginary, real
    return straight, turned


@part
def _write_shares(distance: float, grid: DelayGrid, value: Array, slope: Array) -> int:
    """Write the shares (STENCIL,) of a distance in m, and their derivatives by it; return where the stencil begins."""
    pitch = grid.distances[1] - grid.distances[0]
    at = (distance - grid.distances[0]) / pitch
    at = min(max(at, MARGIN - 1.0), len(grid.distances) - MARGIN - 1e-9)
    low = int(at)
    u = 2.0 * (at - low) - 1.0
    value[:], slope[:] = 0.0, 0.0
    for k in range(len(grid.shares) - 1, -1, -1):
        for j in range(STENCIL):
            slope[j] = slope[j] * u + value[j]
            value[j] = value[j] * u + grid.shares[k, j]
    for j in range(STENCIL):
        slope[j] *= 2.0 / pitch
    return low - MARGIN + 1


@part(fastmath=ANY_ORDER)
def correlate(samples: Array, distance: float, grid: DelayGrid, out: Array) -> None:
    """Write (2, ports): samples (ports, D), correlated with the tones of the grid, correlated with those of a distance
    in m, and the derivative by it.
    """
    value, slope = np.empty(STENCIL), np.empty(STENCIL)
    first = _write_shares(distance, grid, value, slope)
    for m in range(len(samples)):
        real, imaginary, slope_real, slope_imaginary = 0.0, 0.0, 0.0, 0.0
        for j in range(STENCIL):
            sample = samples[m, first + j]
            real += value[j] * sample.real
            imaginary += value[j] * sample.imag
            slope_real += slope[j] * sample.real
            slope_imaginary += slope[j] * sample.imag
        out[0, m], out[1, m] = complex(real, imaginary), complex(slope_real, slope_imaginary)


@part(fastmath={"contract"})
def write_on_delays(distance: float, grid: DelayGrid, out: Array) -> None:
    """Write (D,): the tones of a distance in m, of size 1 each, correlated with those of the grid."""
    value, slope = np.empty(STENCIL), np.empty(STENCIL)
    start = len(out) - 1 - _write_shares(distance, grid, value, slope)
    out[:] = 0.0
    for j in range(STENCIL):
        share, alike = np.float32(value[j]), grid.alike[start - j : start - j + len(out)]
        for d in range(len(out)):
            out[d] += share * alike[d]


@lean(fastmath=ANY_ORDER)
def _inner(left: Array, right: Array) -> complex:
    """Return left^H right of vectors (n,)."""
    real, imaginary = 0.0, 0.0
    for m in range(len(left)):
        a, b, c, d = left[m].real, left[m].imag, right[m].real, right[m].imag
        real += a * c + b * d
        imaginary += a * d - b * c
    return complex(real, imaginary)


@part
def _write_tones(distance: float, rate: Array, out: Array) -> None:
    """Write (2, tones): e^(-j rate d) of a path at a distance in m, and its derivative by it."""
    cosine, sine = np.empty(len(rate)), np.empty(len(rate))
    write_phasors(rate * distance, cosine, sine)
    for f in range(len(rate)):
        out[0, f] = complex(cosine[f], -sine[f])
        out[1, f] = complex(-rate[f] * sine[f], -rate[f] * cosine[f])


@part
def on_ports_of(geometry: Array, weights: Array, m: SteeringModel) -> Array:
    """Return what paths at `geometry` (n, 3) with weights (n, 2) give the ports (n, ports), in single precision."""
    value, _, _ = steer(geometry[:, 1].copy(), geometry[:, 2].copy(), m)
    n, ports, _ = value.shape
    out = np.empty((n, ports), np.complex64)
    for p in range(n):
        for port in range(ports):
            out[p, port] = value[p, port, 0] * weights[p, 0] + value[p, port, 1] * weights[p, 1]
    return out


@part
def _cholesky_inverse(gram: Array) -> Array:
    """Return the inverse of a Hermitian positive matrix (n, n), with a small ridge."""
    n = len(gram)
    largest = 0.0
    for i in range(n):
        largest = max(largest, gram[i, i].real)
    factor = np.zeros((n, n), np.complex128)
    for j in range(n):
        total = gram[j, j].real + thresholds.RIDGE * largest
        for k in range(j):
            total -= factor[j, k].real ** 2 + factor[j, k].imag ** 2
        pivot = math.sqrt(max(total, 0.1 * thresholds.RIDGE * largest))
        factor[j, j] = pivot
        for i in range(j + 1, n):
            entry = gram[i, j]
            for k in range(j):
                entry -= factor[i, k] * factor[j, k].conjugate()
            factor[i, j] = entry / pivot
    lower = np.zeros((n, n), np.complex128)
    for j in range(n):
        lower[j, j] = 1.0 / factor[j, j].real
        for i in range(j + 1, n):
            entry = 0j
            for k in range(j, i):
                entry -= factor[i, k] * lower[k, j]
            lower[i, j] = entry / factor[i, i].real
    return lower.conj().T @ lower


@part
def _normal_equations(
    samples: Array, grid: DelayGrid, geometry: Array, value: Array, by_az: Array, by_el: Array, rate: Array
) -> Normal:
    """Return the fit of n paths at `geometry` (n, 3) to `samples` (ports, D) with steering (n, ports, 2) and the phase
    `rate` (tones,) of the tones in rad per m.
    """
    n, ports, tones = len(geometry), len(samples), len(rate)
    delay, correlated = np.empty((2 * n, tones), np.complex128), np.empty((2 * n, ports), np.complex128)
    steering = np.empty((2 * n, ports), np.complex128)
    for p in range(n):
        _write_tones(geometry[p, 0], rate, delay[2 * p : 2 * p + 2])
        correlate(samples, geometry[p, 0], grid, correlated[2 * p : 2 * p + 2])
        for m in range(ports):
            steering[2 * p, m], steering[2 * p + 1, m] = value[p, m, 0], value[p, m, 1]
    on_tones, G = delay.conj() @ delay.T, steering.conj() @ steering.T
    b = np.empty(2 * n, np.complex128)
    for a in range(2 * n):
        path = a - a % 2
        b[a] = _inner(steering[a], correlated[path])
        for c in range(2 * n):
            G[a, c] *= on_tones[path, c - c % 2]
    inverse = _cholesky_inverse(G)
    w = inverse @ b
    explained = 0.0
    for a in range(2 * n):
        explained += (b[a].conjugate() * w[a]).real
    D = np.empty((3 * n, ports), np.complex128)
    for p in range(n):
        _write_columns(value[p], by_az[p], by_el[p], w[2 * p : 2 * p + 2], D[3 * p : 3 * p + 3])
    left = D.conj()
    own, C, gradient = left @ D.T, left @ steering.T, np.empty(3 * n)
    for a in range(3 * n):
        tone = _tone(a)
        slope = _inner(D[a], correlated[tone])
        for c in range(3 * n):
            own[a, c] *= on_tones[tone, _tone(c)]
        for c in range(2 * n):
            C[a, c] *= on_tones[tone, c - c % 2]
            slope -= C[a, c] * w[c]
        gradient[a] = slope.real
    information = np.ascontiguousarray((own - C @ inverse @ C.conj().T).real)
    return Normal(explained, w.reshape(n, 2), _wald(inverse, w), information, gradient)


@part
def _write_columns(value: Array, by_az: Array, by_el: Array, w: Array, out: Array) -> None:
    """Write a path's columns (3, ports) of the Jacobian, less their tones, at weights `w` (2,)."""
    for m in range(len(value)):
        out[0, m] = value[m, 0] * w[0] + value[m, 1] * w[1]
        out[1, m] = by_az[m, 0] * w[0] + by_az[m, 1] * w[1]
        out[2, m] = by_el[m, 0] * w[0] + by_el[m, 1] * w[1]


@part
def _tone(column: int) -> int:
    """Return which tones a column of the Jacobian has: a path's own, or by distance their derivative."""
    return 2 * (column // 3) + (1 if column % 3 == 0 else 0)


@part
def _wald(inverse: Array, w: Array) -> Array:
    """Return the energy w_p^H ((G^-1)_pp)^-1 w_p that would be lost with each path (n,)."""
    out = np.empty(len(w) // 2)
    for p in range(len(out)):
        i, j = 2 * p, 2 * p + 1
        a, d, b = inverse[i, i].real, inverse[j, j].real, inverse[i, j]
        determinant = max(a * d - b.real**2 - b.imag**2, 1e-300)
        wi, wj = w[i], w[j]
        energy = d * abs(wi) ** 2 + a * abs(wj) ** 2 - 2.0 * (wi.conjugate() * b * wj).real
        out[p] = energy / determinant
    return out


@part
def _normal_equations_of_one(
    samples: Array, grid: DelayGrid, distance: float, value: Array, by_az: Array, by_el: Array, rate: Array
) -> Normal:
    """Return the same of one path, without matrix products: what the search evaluates most takes 3/4 of the time."""
    ports = len(samples)
    correlated, steering = np.empty((2, ports), np.complex128), np.empty((2, ports), np.complex128)
    D = np.empty((3, ports), np.complex128)
    correlate(samples, distance, grid, correlated)
    on_tones = np.empty((2, 2), np.complex128)
    on_tones[0, 0], on_tones[1, 1] = len(rate), (rate * rate).sum()
    on_tones[0, 1] = complex(0.0, -rate.sum())
    on_tones[1, 0] = on_tones[0, 1].conjugate()
    G, b = np.empty((2, 2), np.complex128), np.empty(2, np.complex128)
    for a in range(2):
        for m in range(ports):
            steering[a, m] = value[m, a]
    for a in range(2):
        b[a] = _inner(steering[a], correlated[0])
        for c in range(2):
            G[a, c] = _inner(steering[a], steering[c]) * on_tones[0, 0]
    inverse = _cholesky_inverse(G)
    w = inverse @ b
    explained = (b[0].conjugate() * w[0] + b[1].conjugate() * w[1]).real
    _write_columns(value, by_az, by_el, w, D)
    information, gradient, C = np.empty((3, 3)), np.empty(3), np.empty((3, 2), np.complex128)
    for a in range(3):
        tone = _tone(a)
        for c in range(2):
            C[a, c] = _inner(D[a], steering[c]) * on_tones[tone, 0]
        slope = _inner(D[a], correlated[tone]) - C[a, 0] * w[0] - C[a, 1] * w[1]
        gradient[a] = slope.real
    for a in range(3):
        for c in range(a + 1):
            own = _inner(D[a], D[c]) * on_tones[_tone(a), _tone(c)]
            for i in range(2):
                for j in range(2):
                    own -= C[a, i] * inverse[i, j] * C[c, j].conjugate()
            information[a, c] = information[c, a] = own.real
    return Normal(explained, w.reshape(1, 2), np.array([explained]), information, gradient)


@part
def evaluate(samples: Array, grid: DelayGrid, geometry: Array, m: SteeringModel) -> Normal:
    """Return the normal equations of a fit at `geometry` (n, 3), m, rad, rad, to `samples` (ports, D)."""
    value, by_az, by_el = steer(geometry[:, 1].copy(), geometry[:, 2].copy(), m)
    if len(geometry) == 1:
        return _normal_equations_of_one(samples, grid, geometry[0, 0], value[0], by_az[0], by_el[0], m.rate)
    return _normal_equations(samples, grid, geometry, value, by_az, by_el, m.rate)


@njit(cache=True, nogil=True)
def climb(
    samples: Array, grid: DelayGrid, start: Array, least_gain: float, promising: float, m: SteeringModel
) -> tuple[Array, Normal]:
    """Return geometry (n, 3) in m, rad, rad and normal equations of the joint fit to `samples` (ports, D) that starts
    at `start` (n, 3); done when a step gains less than `least_gain`, an energy as in the samples.

    It ends at once where neither the start nor what the first step promises reaches the energy `promising`.
    """
    geometry, damping = start.copy(), thresholds.LEAST_DAMPING
    normal = evaluate(samples, grid, geometry, m)
    for iteration in range(thresholds.MOST_STEPS):
        matrix = normal.information.copy()
        for i in range(len(matrix)):
            matrix[i, i] += damping * matrix[i, i] + 1e-30
        step = np.linalg.solve(matrix, normal.gradient)
        gain = 0.0
        for i in range(len(step)):
            gain += step[i] * normal.gradient[i]
        if gain < least_gain or (iteration == 0 and normal.explained + gain < promising):
            break
        moved = geometry.copy()
        for p in range(len(moved)):
            for c in range(3):
                longest = thresholds.LONGEST_STEP_M * grid.coarser if c == 0 else thresholds.LONGEST_STEP_RAD
                moved[p, c] += min(max(step[3 * p + c], -longest), longest)
            moved[p, 1] = wrap(moved[p, 1])
            moved[p, 2] = min(max(moved[p, 2], -thresholds.STEEPEST_RAD), thresholds.STEEPEST_RAD)
        trial = evaluate(samples, grid, moved, m)
        if trial.explained > normal.explained:
            geometry, normal, damping = moved, trial, 0.1 * damping
        else:
            damping = max(10.0 * damping, thresholds.LEAST_DAMPING)
    return geometry, normal


@part
def inverse_information(information: Array) -> Array:
    """Return the covariance (3 n, 3 n) of all paths' geometry at unit disturbance, of their `information`."""
    scale = 1.0 / np.sqrt(np.maximum(2.0 * np.diag(information), 1e-30))
    both = np.outer(scale, scale)
    return np.linalg.inv(2.0 * information * both + 1e-9 * np.eye(len(scale))) * both


@lean(fastmath={"contract"})
def subtract_products(row: Array, factor: Array, straight: Array, turned: Array, out: Array) -> None:
    """Write `row` (2 c,) less the sum of complex factors (n,) times columns (n, 2 c), as `in_pairs` gives them; `out`
    may be the row itself.
    """
    for j in range(len(out)):
        out[j] = row[j]
    for p in range(len(factor)):
        real, imaginary, along, across = factor[p].real, factor[p].imag, straight[p], turned[p]
        for j in range(len(out)):
            out[j] -= real * along[j] + imaginary * across[j]
