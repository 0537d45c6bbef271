"""The assignment of measurements to VTs of one link, exact, with the option of leaving any of them out.

Most snapshots need no solver: where no measurement has two candidate VTs and no VT two candidate measurements, every
positive pair is taken. Otherwise the shortest-augmenting-path form of the Hungarian algorithm (Kuhn 1955; Jonker and
Volgenant 1987) runs on the table with one free column a row.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def assign(score, rows, columns, row_of, work_f, work_i):
    """Write into row_of (columns,) the row assigned to each column, -1 for none, maximising the sum of scores.

    `score` (R, C): gain of a pair over leaving both out; pairs that are not positive are never taken. `work_f` and
    `work_i`
    are scratch of at least (4 (rows + columns + 2),) floats and integers.
    """
    for c in range(columns):
        row_of[c] = -1
    conflict = False
    for r in range(rows):
        taken = 0
        for c in range(columns):
            if score[r, c] > 0.0:
                taken += 1
                if row_of[c] >= 0:
                    conflict = True
                row_of[c] = r
        if taken > 1:
            conflict = True
    if conflict:
        _augment(score, rows, columns, row_of, work_f, work_i)


@njit(cache=True)
def _augment(score, rows, columns, row_of, work_f, work_i):
    """Solve the general case: columns 1..columns are real, column columns + r is row r's own 'left out', at gain 0."""
    width = columns + rows + 1
    u, v = work_f[: rows + 1], work_f[rows + 1 : rows + 1 + width]
    least = work_f[rows + 1 + width : rows + 1 + 2 * width]
    owner, way, used = work_i[:width], work_i[width : 2 * width], work_i[2 * width : 3 * width]
    u[:] = 0.0
    v[:] = 0.0
    owner[:] = 0
    for r in range(1, rows + 1):
        owner[0] = r
        j0 = 0
        least[:] = np.inf
        used[:] = 0
        while True:
            used[j0] = 1
            i0 = owner[j0]
            delta = np.inf
            j1 = 0
            for j in range(1, width):
                if used[j] == 0:
                    if j <= columns:
                        gain = score[i0 - 1, j - 1]
                        cost = -gain if 0.0 < gain < np.inf else np.inf
                    else:
                        cost = 0.0 if j - columns == i0 else np.inf
                    reduced = cost - u[i0] - v[j]
                    if reduced < least[j]:
                        least[j] = reduced
                        way[j] = j0
                    if least[j] < delta:
                        delta = least[j]
                        j1 = j
            for j in range(width):
                if used[j] == 1:
                    u[owner[j]] += delta
                    v[j] -= delta
                else:
                    least[j] -= delta
            j0 = j1
            if owner[j0] == 0:
                break
        while j0 != 0:
            j1 = way[j0]
            owner[j0] = owner[j1]
            j0 = j1
    for c in range(columns):
        row_of[c] = owner[c + 1] - 1
