"""What the figures of a sweep show, and are drawn from: panels of worlds, in them series of estimators with options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.metrics import METRIC
from cellslam.benchmarks.scores.statistics import interval, statistic
from cellslam.benchmarks.scores.verdicts import Verdict
from cellslam.benchmarks.sweeps.rows import oracles, results, varying_keys
from cellslam.benchmarks.sweeps.store import trajectory_of
from cellslam.benchmarks.sweeps.trajectories import Trajectory
from cellslam.benchmarks.tables.rankings import verdicts
from cellslam.benchmarks.tables.summaries import CONFIDENCE, finite, groups
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    import pandas as pd

MOST_TRAJECTORIES = 200
POINTS_IN_TIME = 400


@dataclass(frozen=True)
class CurveChoice:
    """What the sweep curve shows: key along x (None: the first that varies, a number if any is), metric, statistic."""

    x: str | None = None
    metric: str = "position_rmse_m"
    statistic: str = "median"
    confidence: float = CONFIDENCE

    @property
    def label(self) -> str:
        """The label of an axis: the metric, and how trials are summed up."""
        how = "root mean square" if self.statistic == "rmse" else self.statistic
        return f"{axis(self.metric)},\n{how} over trials"

    def summed(self, values: Floats) -> Floats:
        """Return the statistic of values (n,), in their units, and the ends of its interval (3,); NaN: it has none."""
        of = statistic(self.statistic)
        return np.array([float(of.of(values)), *interval(values, of, self.confidence)])


def axis(metric: str) -> str:
    """Return the label of an axis of a metric."""
    return METRIC[metric].label or METRIC[metric].titled


@dataclass(frozen=True)
class Series:
    """The rows of one estimator with one set of options, in one panel.

    `settings`: what varies of the world; `options`: what varies of the estimator, None where it has no such option.
    """

    label: str
    settings: dict[str, Any]
    options: dict[str, Any]
    rows: pd.DataFrame

    @property
    def estimator(self) -> str:
        """The estimator's name."""
        return str(self.rows["estimator"].iloc[0])

    @property
    def ok(self) -> pd.DataFrame:
        """The rows of the trials that did not fail."""
        return self.rows[self.rows["status"] == "ok"]

    def values(self, metric: str) -> Floats:
        """Return a metric's values (n,), in the metric's units, in the n trials that are ok and have it."""
        return finite(self.ok[metric])


@dataclass(frozen=True, eq=False)
class Panel:
    """The series that met the same worlds."""

    title: str
    series: tuple[Series, ...]


@dataclass(frozen=True)
class SweepData:
    """All panels of a sweep, and the world's keys that vary."""

    folder: Path
    panels: tuple[Panel, ...]
    world_keys: tuple[str, ...]

    @property
    def series(self) -> list[Series]:
        """The series of all panels, in order."""
        return [one for panel in self.panels for one in panel.series]

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of all series, in order."""
        return tuple(dict.fromkeys(one.label for one in self.series))

    def drives(self, series: Series) -> Iterator[Trajectory]:
        """Yield the trajectories of a series that are kept, two hundred at the most."""
        kept = (trajectory_of(self.folder, key) for key in series.ok["key"].tolist()[:MOST_TRAJECTORIES])
        yield from (trajectory for trajectory in kept if trajectory is not None)

    def over_time(self, series: Series, column: str) -> tuple[Floats, Floats] | None:
        """Return time (P,) in s and a column of the trajectories (N, P), or (N, P, S) for offsets; None without any."""
        found = [trajectory for trajectory in self.drives(series) if len(getattr(trajectory, column))]
        if not found:
            return None
        end = min(float(trajectory.time_s[-1]) for trajectory in found)
        time_s = np.linspace(0.0, end, min(POINTS_IN_TIME, min(len(t.time_s) for t in found)))
        return time_s, np.stack([_at(time_s, t.time_s, getattr(t, column)) for t in found])


def load(folder: str | Path) -> SweepData:
    """Return the data of a sweep's folder. Raises InputError if there are no rows."""
    frame = results(folder)
    if frame.empty:
        raise InputError(f"{folder}: no rows yet")
    varied = varying_keys(folder)
    options = [name for name in varied if name.startswith("estimator.")]
    worlds = [name for name in varied if name not in options]
    panels = []
    for settings, group in groups(frame, worlds):
        title = ", ".join(value if key == "scenario" else f"{key} = {shown(value)}" for key, value in settings.items())
        series = tuple(
            Series(label_of(own["estimator"], own, options), settings, {key: own[key] for key in options}, rows)
            for own, rows in groups(group, ["estimator", *options])
        )
        panels.append(Panel(title, series))
    return SweepData(Path(folder), tuple(panels), tuple(worlds))


def verdicts_of(data: SweepData) -> dict[str, Verdict]:
    """Return the verdict on each panel's series, and over all panels."""
    import pandas as pd

    panels = {p.title: pd.concat([one.rows.assign(label=one.label) for one in p.series]) for p in data.panels}
    return verdicts(panels, oracles(data.folder), "label")


def curve_keys(data: SweepData) -> dict[str, bool]:
    """Return what a sweep curve can have along x, the world's keys and options that vary, and whether it is a number.

    Numbers come first.
    """
    worlds = {key: {one.settings[key] for one in data.series} for key in data.world_keys}
    options = {key: {one.options[key] for one in data.series} - {None} for key in data.series[0].options}
    several = {key: values - {None} for key, values in {**worlds, **options}.items() if len(values) > 1}
    found = {key: all(map(_is_number, values)) for key, values in several.items()}
    return dict(sorted(found.items(), key=lambda item: not item[1]))


def sweep_lines(data: SweepData, x: str) -> dict[str, list[tuple[float | str | None, Series]]]:
    """Return the lines of a sweep curve by name, each its points in order; other keys that vary are in the names.

    Where x is no number, each of its values is a text. x None: the series has no such option, or its world no such
    key, and is the same at every x.
    """
    lines: dict[str, list[tuple[float | str | None, Series]]] = {}
    numbers = curve_keys(data)[x]
    for one in data.series:
        value = one.settings.get(x, one.options.get(x))
        label = label_of(one.estimator, one.options, [key for key in one.options if key != x])
        others = other_settings(one, x)
        if value is None and x in one.settings:
            # A line of its own beside a numeric axis, a place of its own on one of texts.
            others += [f"without {x}"] if numbers else []
            value = None if numbers else "-"
        place = None if value is None else float(value) if numbers else shown(value)
        lines.setdefault(", ".join([label, *others]), []).append((place, one))
    if not numbers:
        return lines
    return {name: sorted(points, key=lambda point: float(point[0] or 0.0)) for name, points in lines.items()}


def other_settings(one: Series, x: str) -> list[str]:
    """Return the keys of the world that vary besides x, each with its value in this series."""
    return [f"{key} = {shown(setting)}" for key, setting in one.settings.items() if key != x]


def shown(value: Any) -> str:
    """Return a setting's value as text."""
    return f"{value:g}" if isinstance(value, float) else "-" if value is None else str(value)


def label_of(estimator: str, own: Mapping[str, Any], options: Sequence[str]) -> str:
    """Return what a series is called: its estimator, and the options that vary."""
    parts = [f"{name.rpartition('.')[2]} = {shown(own[name])}" for name in options if own[name] is not None]
    return ", ".join([estimator, *parts])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _at(time_s: Floats, own_s: Any, column: Any) -> Floats:
    """Return a column (T,) or (T, S) at other times (P,)."""
    if column.ndim == 1:
        return np.asarray(np.interp(time_s, own_s, column))
    return np.stack([np.interp(time_s, own_s, column[:, s]) for s in range(column.shape[1])], axis=1)
