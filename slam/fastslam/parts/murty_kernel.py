"""The best assignments in order (Murty 1968), and a draw among them: small tables, as gating leaves them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LEFT_OUT = -1e30  # score of a pair that cannot be
_FREE, _NONE = -2, -1  # of what is fixed: nothing; that the column has no row


@njit(cache=True, error_model="numpy")
def murty(score, rows, columns, most, uniform, row_of):
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
    return totals[chosen] - totals[0] - math.log(weight)


@njit(cache=True, error_model="numpy")
def best_assignments(score, rows, columns, choices, totals):
    """Write the best assignments, best first, into choices (most, columns), row of each column or -1, and totals
    (most,); return how many there are.

    Each found assignment splits the rest of its set by the first column in which they differ from it (Murty's
    partition); a set is kept as its fixed columns and forbidden pairs.
    """
    most = len(totals)
    room = most * columns + 1
    fixed = np.empty((room, columns), np.int64)
    forbidden = np.empty((room, columns, rows + 1), np.bool_)  # the last: having no row
    best, value = np.empty((room, columns), np.int64), np.empty(room)
    fixed[0], forbidden[0] = _FREE, False
    value[0] = _solve(score, rows, columns, fixed[0], forbidden[0], best[0])
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
            value[sets] = _solve(score, rows, columns, fixed[sets], forbidden[sets], best[sets])
            sets += 1
    return count


@njit(cache=True, error_model="numpy")
def _solve(score, rows, columns, fixed, forbidden, row_of):
    """Write the best assignment that keeps to a set, return its total, LEFT_OUT if there is none.

    Shortest augmenting paths (Jonker and Volgenant 1987), column by column: each has a place of its own for having no
    row.
    """
    places = rows + columns
    price, potential = np.zeros(places + 1), np.zeros(columns + 1)
    owner, way = np.zeros(places + 1, np.int64), np.zeros(places + 1, np.int64)
    least, used = np.empty(places + 1), np.empty(places + 1, np.bool_)
    for column in range(1, columns + 1):
        owner[0] = column
        j0 = 0
        least[:] = np.inf
        used[:] = False
        while True:
            used[j0] = True
            i0, delta, j1 = owner[j0], np.inf, -1
            for j in range(1, places + 1):
                if not used[j]:
                    reduced = _cost(score, rows, fixed, forbidden, i0 - 1, j - 1) - potential[i0] - price[j]
                    if reduced < least[j]:
                        least[j], way[j] = reduced, j0
                    if least[j] < delta:
                        delta, j1 = least[j], j
            if j1 < 0:
                return LEFT_OUT
            for j in range(places + 1):
                if used[j]:
                    potential[owner[j]] += delta
                    price[j] -= delta
                else:
                    least[j] -= delta
            j0 = j1
            if owner[j0] == 0:
                break
        while j0 != 0:
            owner[j0] = owner[way[j0]]
            j0 = way[j0]
    total = 0.0
    for j in range(1, places + 1):
        if owner[j] > 0:
            row_of[owner[j] - 1] = j - 1 if j <= rows else _NONE
            total += score[j - 1, owner[j] - 1] if j <= rows else 0.0
    return total


@njit(cache=True, error_model="numpy")
def _cost(score, rows, fixed, forbidden, column, place):
    """Return what a column pays for a place: a row, or from `rows` on the places of columns that have none."""
    if place >= rows:
        wanted = _NONE
        if place - rows != column or forbidden[column, rows]:
            return np.inf
    else:
        wanted = place
        if forbidden[column, place] or score[place, column] < 0.5 * LEFT_OUT:
            return np.inf
    if fixed[column] != _FREE and fixed[column] != wanted:
        return np.inf
    return -score[place, column] if place < rows else 0.0
