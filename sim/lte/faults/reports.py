"""How the receiver's reports come: with a late time stamp, or once more in place of the next one.

Source: own model, of independent faults of single reports.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.recording import Floats, Ints

if TYPE_CHECKING:
    from cellslam.sim.lte.statistical.statistical_front_end import Detections


class Reports(NamedTuple):
    """Of T snapshots: the snapshot whose report each one has, `source` (T,), and by how much the stamp of its own
    report is late, `late_s` (T,) in s."""

    source: Ints
    late_s: Floats

    def age_s(self, time_s: Floats) -> Floats:
        """Return how much older than their stamps time_s (T,) the measurements are, (T,) in s."""
        return np.asarray(time_s - time_s[self.source] + self.late_s[self.source])


def draw_reports(config: RadioConfig, count: int, rng: np.random.Generator) -> Reports | None:
    """Draw how the reports of so many snapshots come; None: each in time, and once."""
    if config.late_probability == 0.0 and config.repeat_probability == 0.0:
        return None
    late, repeated = rng.random((2, count)) < np.array([[config.late_probability], [config.repeat_probability]])
    repeated[0], snapshot = False, np.arange(count)
    return Reports(np.maximum.accumulate(np.where(repeated, 0, snapshot)), config.late_s * late)


def poses_before(poses: Floats, time_s: Floats, late_s: Floats) -> Floats:
    """Return poses (T, 6) of a drive, in m and rad, so long (T,) before its snapshots, in s."""
    late = late_s > 0.0
    out = poses.copy()
    for c in range(6):
        column = np.unwrap(poses[:, c]) if c >= 3 else poses[:, c]
        out[late, c] = np.interp((time_s - late_s)[late], time_s, column)
    return out


def as_reported(found: Detections, reports: Reports) -> Detections:
    """Return detections in which some snapshots have those of another one once more."""
    m = found.measurements
    first = np.searchsorted(m.snapshot, np.arange(len(reports.source) + 1))
    count = np.diff(first)[reports.source]
    begin = first[reports.source] - np.concatenate([[0], np.cumsum(count)[:-1]])
    rows = np.repeat(begin, count) + np.arange(count.sum())
    columns: dict[str, Any] = {name: None if c is None else c[rows] for name, c in vars(m).items()}
    columns["snapshot"] = np.repeat(np.arange(len(count)), count)
    own: dict[str, Any] = {name: column[rows] for name, column in vars(found).items() if name != "measurements"}
    return replace(found, measurements=replace(m, **columns), **own)
