"""Compiled: copies of arrays, sums of logarithms, and P <- P - G^T G: what many measurements take off a covariance.

Source: rank-k update of a symmetric matrix (SYRK) of Dongarra et al., "A set of level 3 basic linear algebra
subprograms", ACM Trans. Mathematical Software 16(1), 1990.
"""

from __future__ import annotations

import math
from typing import Any

from cellslam.sim.compiling import lean
from cellslam.sim.recording import Floats


@lean
def put(out: Any, given: Any) -> None:
    """Write the numbers of `given` (n,) to the first of `out`.

    Where an array is assigned to a part of another one, Numba also compiles the text of the error that this might
    raise, which takes 1.6 s in each process that compiles.
    """
    for i in range(len(given)):
        out[i] = given[i]


@lean(fastmath={"contract"})
def downdate(p: Floats, n: int, g: Floats, k: int) -> None:
    """Subtract from the first n rows and columns of a symmetric P the products of k gains (rows of g).

    Of g (K, N) rows k to k + 3 are zeroed, K >= k + 3. The lower triangle, four rows and four gains at once, which
    leaves P in the fastest memory and takes each gain from the next a quarter as often; then the columns above them,
    their mirror image.
    """
    g[k : k + 3, :n] = 0.0
    whole = n // 4 * 4
    for i in range(0, whole, 4):
        r0, r1, r2, r3 = p[i], p[i + 1], p[i + 2], p[i + 3]
        for j in range(0, k, 4):
            g0, g1, g2, g3 = g[j], g[j + 1], g[j + 2], g[j + 3]
            a0, a1, a2, a3 = g0[i], g1[i], g2[i], g3[i]
            b0, b1, b2, b3 = g0[i + 1], g1[i + 1], g2[i + 1], g3[i + 1]
            c0, c1, c2, c3 = g0[i + 2], g1[i + 2], g2[i + 2], g3[i + 2]
            d0, d1, d2, d3 = g0[i + 3], g1[i + 3], g2[i + 3], g3[i + 3]
            for x in range(i + 4):
                y0, y1, y2, y3 = g0[x], g1[x], g2[x], g3[x]
                r0[x] -= a0 * y0 + a1 * y1 + a2 * y2 + a3 * y3
                r1[x] -= b0 * y0 + b1 * y1 + b2 * y2 + b3 * y3
                r2[x] -= c0 * y0 + c1 * y1 + c2 * y2 + c3 * y3
                r3[x] -= d0 * y0 + d1 * y1 + d2 * y2 + d3 * y3
        for x in range(i):
            above = p[x]
            above[i], above[i + 1], above[i + 2], above[i + 3] = r0[x], r1[x], r2[x], r3[x]
    for i in range(whole, n):
        row = p[i]
        for j in range(0, k, 4):
            g0, g1, g2, g3 = g[j], g[j + 1], g[j + 2], g[j + 3]
            a0, a1, a2, a3 = g0[i], g1[i], g2[i], g3[i]
            for x in range(i + 1):
                row[x] -= a0 * g0[x] + a1 * g1[x] + a2 * g2[x] + a3 * g3[x]
        for x in range(i):
            p[x, i] = row[x]


@lean
def log_sum(a: float, b: float) -> float:
    """Return log(exp(a) + exp(b)), one of which is finite."""
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))
