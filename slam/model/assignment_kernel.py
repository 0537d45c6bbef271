"""The assignment of measurements to VTs of one link, exact, with the option of leaving any of them out.

Most snapshots need no solver: where no measurement has two candidate VTs and no VT two candidate measurements, every
positive pair is taken. Otherwise shortest augmenting paths run on the table with one more row for each column, which
leaves that column out.

Sources: Kuhn, "The Hungarian method for the assignment problem", Naval Research Logistics Quarterly 2, 1955; Jonker and
Volgenant, "A shortest augmenting path algorithm for dense and sparse linear assignment problems", Computing 38, 1987.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints


@njit(cache=True)
def assign(score: Floats, rows: int, columns: int, row_of: Ints, work_f: Floats, work_i: Ints) -> None:
    """Write into row_of (columns,) the row assigned to each column, -1 for none, maximising the sum of scores.

    `score` (R, C), in any one unit: gain of a pair over leaving both out; pairs that are not positive are never taken.
    `work_f` and `work_i` are scratch of at least (4 (rows + columns + 2),) floats and integers.
    """
    for c in range(columns):
        row_of[c] = -1
    conflict = False
    for r in range(rows):
        taken = 0
        for c in range(columns):
            if score[r, c] > 0.0:
                taken += 1
                conflict = conflict or row_of[c] >= 0 or taken > 1
                row_of[c] = r
    if conflict:
        _augment(score, rows, columns, row_of, work_f, work_i)


@part
def _augment(score: Floats, rows: int, columns: int, row_of: Ints, work_f: Floats, work_i: Ints) -> None:
    """Write into row_of (columns,) the assignment with the greatest sum of scores, -1 for none."""
    places = rows + columns + 1
    potential, price = work_f[: columns + 1], work_f[columns + 1 : columns + 1 + places]
    shortest = work_f[columns + 1 + places : columns + 1 + 2 * places]
    owner, previous, used = work_i[:places], work_i[places : 2 * places], work_i[2 * places : 3 * places]
    potential[:] = 0.0
    price[:] = 0.0
    owner[:] = 0
    for column in range(1, columns + 1):
        owner[0] = column
        j0 = 0
        shortest[:] = np.inf
        used[:] = 0
        while True:
            used[j0] = 1
            i0, delta, j1 = owner[j0], np.inf, -1
            for j in range(1, places):
                if used[j] == 0:
                    reduced = _cost(score, rows, i0 - 1, j - 1) - potential[i0] - price[j]
                    if reduced < shortest[j]:
                        shortest[j], previous[j] = reduced, j0
                    if shortest[j] < delta:
                        delta, j1 = shortest[j], j
            for j in range(places):
                if used[j] == 1:
                    potential[owner[j]] += delta
                    price[j] -= delta
                else:
                    shortest[j] -= delta
            j0 = j1
            if owner[j0] == 0:
                break
        while j0 != 0:
            owner[j0] = owner[previous[j0]]
            j0 = previous[j0]
    for j in range(1, places):
        if owner[j] > 0:
            row_of[owner[j] - 1] = j - 1 if j <= rows else -1


@part
def _cost(score: Floats, rows: int, column: int, place: int) -> float:
    """Return what a column pays for a place: a row, or from `rows` on the places of columns that have none."""
    if place < rows:
        gain = score[place, column]
        return -gain if gain > 0.0 else np.inf
    return 0.0 if place - rows == column else np.inf
