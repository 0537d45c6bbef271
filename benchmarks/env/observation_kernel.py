"""Compiled: the flat observations of many drives at once, as `gymnasium.wrappers.FlattenObservation` lays them out.

Order: dt_s, last_action, link, mask, measured, odometry, paths, unit, P paths each where there are paths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit

Floats32 = NDArray[np.float32]
COLUMNS, SNR_DB = 7, 3


class Drives(NamedTuple):
    """Drives one after the other: T snapshots and M paths of all.

    `rows` (T + 1,): first path of each snapshot; `dt_s` (T,); `odometry` (T, 6); `unit` (T, 6) of an action; `paths`
    (M, 7), NaN: not measured; `link` (M,). Units as of `LocalizationEnv`.
    """

    rows: NDArray[np.int64]
    dt_s: Floats32
    odometry: Floats32
    unit: Floats32
    paths: Floats32
    link: Floats32


@njit(cache=True)
def write_observations(out: Floats32, at: NDArray[np.int64], last_action: Floats32, most: int, drives: Drives) -> None:
    """Write the observations (N, 19 + 16 P) of snapshots `at` (N,) of all drives, each of P = `most` paths.

    `last_action` (N, 6). Where there are more paths, the strongest in their order. One thread: it only writes memory,
    and threads would wait for one another.
    """
    rows, paths = drives.rows, drives.paths
    links, masks, measured = 7, 7 + most, 7 + 2 * most
    speeds = measured + COLUMNS * most
    values = speeds + 6
    units = values + COLUMNS * most
    for i in range(len(at)):
        t = at[i]
        row = out[i]
        row[:] = np.float32(0.0)
        row[0] = drives.dt_s[t]
        row[1:7] = last_action[i]
        row[speeds : speeds + 6] = drives.odometry[t]
        row[units : units + 6] = drives.unit[t]
        begin, count = rows[t], rows[t + 1] - rows[t]
        shown = np.arange(count)
        if count > most:
            snr = np.empty(count)
            for k in range(count):
                value = paths[begin + k, SNR_DB]
                snr[k] = np.inf if np.isnan(value) else -value
            shown = np.sort(np.argsort(snr, kind="mergesort")[:most])
        for k in range(len(shown)):
            path = begin + shown[k]
            row[links + k], row[masks + k] = drives.link[path], 1.0
            for c in range(COLUMNS):
                value = paths[path, c]
                if not np.isnan(value):
                    row[measured + COLUMNS * k + c], row[values + COLUMNS * k + c] = 1.0, value
