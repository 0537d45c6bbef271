"""The best assignments in order, and a draw among them: small tables, as gating leaves them.

Source: Murty, "An algorithm for ranking all the assignments in order of increasing cost", Operations Research 16(3),
1968.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.assignment_kernel import LEFT_OUT, best_sum

Flags = NDArray[np.bool_]

_FREE, _NONE = -2, -1  # of what is fixed: nothing; that the column has no row


@njit(cache=True, error_model="numpy")
def murty(score: Floats, rows: int, columns: int, most: int, uniform: float, row_of: Ints) -> float:
    """Write into row_of (columns,) one of the `most` best assignments, drawn with probabilities in proportion to exp of
    their sums of scores; return the log of the probability of the draw.

    `score` (R, C): log-likelihood ratio of a pair over leaving both out, LEFT_OUT where it cannot be; `uniform`: in
    (0, 1). A column may have no row at a score of 0.
    """
    choices = np.empty((most, columns), np.int64)
    totals = np.empty(most)
    count = best_assignments(score, rows, columns, choices, totals)
    weight = 0.0
    for i in range(count):
        weight += math.exp(totals[i] - totals[0])
    passed, chosen = 0.0, count - 1
    for i in range(count):
        passed += math.exp(totals[i] - totals[0]) / weight
        if uniform < passed:
            chosen = i
            break
    for c in range(columns):
        row_of[c] = choices[chosen, c]
    return float(totals[chosen] - totals[0] - math.log(weight))


@njit(cache=True, error_model="numpy")
def best_assignments(score: Floats, rows: int, columns: int, choices: Ints, totals: Floats) -> int:
    """Write the best assignments, best first, and their sums of scores; return how many there are.

    score (R, C): log-likelihood ratios as for `murty`; choices (most, columns): row of each column or -1; totals
    (most,). Each found assignment splits the rest of its set by the first column in which they differ from it (Murty's
    partition); a set is kept as its fixed columns and forbidden pairs.
    """
    most = len(totals)
    room = most * columns + 1
    fixed = np.empty((room, columns), np.int64)
    forbidden = np.empty((room, columns, rows + 1), np.bool_)  # the last: having no row
    best, value = np.empty((room, columns), np.int64), np.empty(room)
    fixed[0], forbidden[0] = _FREE, False
    value[0] = _best_of(score, rows, columns, fixed[0], forbidden[0], best[0])
    sets, count = 1, 0
    while count < most:
        at = 0
        for i in range(1, sets):
            if value[i] > value[at]:
                at = i
        if value[at] < 0.5 * LEFT_OUT:
            break
        choices[count], totals[count] = best[at], value[at]
        count += 1
        value[at] = LEFT_OUT
        if count == most:
            break
        for c in range(columns):
            if fixed[at, c] != _FREE:
                continue
            if sets == room:
                break
            fixed[sets], forbidden[sets] = fixed[at], forbidden[at]
            for earlier in range(c):
                fixed[sets, earlier] = choices[count - 1, earlier]
            own = choices[count - 1, c]
            forbidden[sets, c, own if own >= 0 else rows] = True
            value[sets] = _best_of(score, rows, columns, fixed[sets], forbidden[sets], best[sets])
            sets += 1
    return count


@njit(cache=True, error_model="numpy")
def _best_of(score: Floats, rows: int, columns: int, fixed: Ints, forbidden: Flags, row_of: Ints) -> float:
    """Write the best assignment that keeps to a set, return its total, LEFT_OUT if there is none."""
    allowed, alone = np.full((rows, columns), LEFT_OUT), np.full(columns, LEFT_OUT)
    for c in range(columns):
        if not forbidden[c, rows] and (fixed[c] == _FREE or fixed[c] == _NONE):
            alone[c] = 0.0
        for r in range(rows):
            if not forbidden[c, r] and (fixed[c] == _FREE or fixed[c] == r):
                allowed[r, c] = score[r, c]
    room = 4 * (rows + columns + 2)
    work_f, work_i = np.empty(room), np.empty(room, np.int64)
    return best_sum(allowed, alone, 0.5 * LEFT_OUT, rows, columns, row_of, work_f, work_i)
