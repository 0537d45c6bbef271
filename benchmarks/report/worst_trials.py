"""Which trials a report looks at: the worst of an estimator, and those that failed; and the sections of the worst: what
each estimator answered, in the world made again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.report.scene import Cities, rounded, scene_of
from cellslam.benchmarks.scores.metrics import METRIC, METRIC_KEYS
from cellslam.benchmarks.sweeps.rows import oracles
from cellslam.benchmarks.sweeps.store import reading, trajectory_of
from cellslam.benchmarks.sweeps.tasks import identity
from cellslam.benchmarks.sweeps.trajectories import Trajectory
from cellslam.benchmarks.tables.summaries import check_metric
from cellslam.scenarios.loading import from_tables
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.own_code import FILES, allow
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Ints

if TYPE_CHECKING:
    from cellslam.benchmarks.figures.sweep.sweep_data import Panel, Series, SweepData
    from cellslam.sim.world import World

MOST_WORST = 12
MOST_FAILED = 100
STEPS = 300
# A stored error may differ by this much from the one in the world that is made again (stored in single precision).
AGREES_M = 0.02


@dataclass(frozen=True)
class Choice:
    """What a report shows of the worst trials: how many of each of these estimators, and by which metric.

    `estimators` empty: the one whose median is lowest, oracles aside.
    """

    worst: int = 3
    metric: str = "position_rmse_m"
    estimators: Sequence[str] = ()


@dataclass(frozen=True)
class Worst:
    """A trial to look at: its panel, the series it is worst of, its value there."""

    panel: Panel
    label: str
    trial: int
    seed: int
    value: float


def worst_trials(data: SweepData, choice: Choice) -> list[Worst]:
    """Return the worst trials of each chosen estimator, the worst first. Raises InputError."""
    check_metric(choice.metric)
    if not 0 <= choice.worst <= MOST_WORST:
        raise InputError(f"--worst {choice.worst}: must be 0 to {MOST_WORST}")
    known = {one.estimator for one in data.series}
    for name in choice.estimators:
        if name not in known:
            raise unknown_name("estimator", name, known)
    out: list[Worst] = []
    for name in choice.estimators or _best(data, choice.metric):
        series = [(panel, one) for panel in data.panels for one in panel.series if one.estimator == name]
        found = [worst for panel, one in series for worst in _trials(panel, one, choice.metric)]
        found.sort(key=lambda worst: (-_badness(worst.value, choice.metric), worst.trial))
        out += _distinct(found, choice.worst)
    return out


def worlds(folder: Path) -> list[dict[str, Any]]:
    """Return the resolved worlds of a store."""
    with reading(folder) as database:
        return [json.loads(text) for (text,) in database.execute("SELECT tables FROM worlds ORDER BY id")]


def load_code(folder: Path) -> None:
    """Import the code that the worlds of a store name (as waveforms and path losses), and let their files be
    read. Raises InputError."""
    for radio in (world["radio"] for world in worlds(folder) if "radio" in world):
        for key, name in RadioConfig(**radio).unasked().items():
            allow(key, name)


def failed_trials(folder: Path) -> dict[str, Any]:
    """Return how many rows failed, and the first of them with what was said."""
    keys = ("estimator", "trial", "seed", "error", "traceback")
    with reading(folder) as database:
        count = database.execute("SELECT count(*) FROM rows WHERE status = 'failed'").fetchone()[0]
        query = f"SELECT {', '.join(keys)} FROM rows WHERE status = 'failed' ORDER BY estimator, trial, key LIMIT ?"
        rows = [dict(zip(keys, row, strict=True)) for row in database.execute(query, (MOST_FAILED,))]
    return {"count": count, "rows": rows}


def _best(data: SweepData, metric: str) -> list[str]:
    """Return the estimator with the lowest median; dead reckoning or an oracle only where there is nothing else."""
    values: dict[str, list[float]] = {}
    for one in data.series:
        values.setdefault(one.estimator, []).extend(one.values(metric).tolist())
    medians = {name: float(np.median(v)) for name, v in values.items() if v}
    marked = {*oracles(data.folder), "dead-reckoning"}
    plain = {name: value for name, value in medians.items() if name not in marked} or medians
    return sorted(plain, key=lambda name: _badness(plain[name], metric))[:1]


def _badness(value: float, metric: str) -> float:
    return -value if METRIC[metric].rising else value


def _trials(panel: Panel, one: Series, metric: str) -> list[Worst]:
    rows = one.ok[["trial", "seed", metric]].astype({metric: float}).itertuples(index=False)
    return [Worst(panel, one.label, int(t), int(s), float(v)) for t, s, v in rows if np.isfinite(v)]


def _distinct(found: list[Worst], count: int) -> list[Worst]:
    """Return the first ones, each trial once, where it is worst: variants of a world share most of their draws."""
    kept: dict[tuple[int, int], Worst] = {}
    for one in found:
        kept.setdefault((one.trial, one.seed), one)
    return list(kept.values())[:count]


def trial_sections(
    folder: Path, data: SweepData, chosen: Sequence[Worst], progress: Progress
) -> tuple[list[dict[str, Any]], Cities]:
    """Return a section for each chosen trial, and the cities that they stand in, each once."""
    cities: Cities = {}
    if not chosen:
        return [], cities
    sections = []
    with progress("making the worst trials' worlds again", len(chosen)) as advance:
        for worst in chosen:
            sections.append(_section(folder, worst, cities))
            advance(1)
    return sections, cities


def estimate_curves(one: Trajectory, steps: Ints) -> dict[str, Any]:
    """Return an estimator's curves at the steps, and when each of its final VTs appears, as number of the step."""

    def curve(column: Any, digits: int) -> Any:
        return rounded(np.asarray(column)[steps].T, digits) if len(column) else []

    # A VT whose first measurement is not known is shown at the end.
    first = np.where(one.vt_first < 0, steps[-1] if len(steps) else 0, one.vt_first)
    return {
        "position": curve(one.poses[:, :3], 2),
        "error": curve(one.error_m, 3),
        "std": curve(one.std_m, 3),
        "nees": curve(one.nees, 3),
        "offset_error": curve(one.offset_error_m, 2),
        "offset_std": curve(one.offset_std_m, 2),
        "vts": rounded(one.vt_m.reshape(-1, 3).T, 1),
        "first": np.searchsorted(steps, first).tolist(),
    }


def _section(folder: Path, worst: Worst, cities: Cities) -> dict[str, Any]:
    asked = ((one.label, _row(one.rows, worst)) for one in worst.panel.series)
    rows = {label: row for label, row in asked if row is not None}
    kept = {label: _trajectory(folder, row) for label, row in rows.items()}
    found = {label: one for label, one in kept.items() if one is not None}
    world, note = _world(folder, str(rows[worst.label]["key"]), worst)
    times: list[Any] = [one.time_s for one in found.values()] + ([] if world is None else [world.drive.time_s])
    time_s = times[0] if times else np.empty(0)
    steps = np.unique(np.linspace(0, max(len(time_s) - 1, 0), STEPS).round().astype(np.int64))
    scene: dict[str, Any] = {}
    if world is not None and _disagrees(world, found):
        note = "The world made again is not the one of the sweep (other versions?): city, truth and rays are left out."
    elif world is not None:
        scene, city = scene_of(world, steps)
        scene["city"] = identity(json.dumps(city))[:12]
        cities.setdefault(scene["city"], city)
    if not found:
        note = f"{note} No trajectories are kept in this sweep (--no-trajectories).".strip()
    return {
        "label": worst.label,
        "value": rounded([worst.value], 4)[0],
        "trial": worst.trial,
        "seed": worst.seed,
        "settings": worst.panel.title,
        "note": note,
        "rows": [{"label": label, **_cells(row)} for label, row in rows.items()],
        "estimates": [{"label": label, **estimate_curves(one, steps)} for label, one in found.items()],
        "time": rounded(time_s[steps], 2) if len(time_s) else [],
        "bound": _bound(found, steps),
        "scene": scene,
    }


def _row(frame: Any, worst: Worst) -> dict[str, Any] | None:
    match = frame[(frame["trial"] == worst.trial) & (frame["seed"] == worst.seed)].to_dict("records")
    return match[0] if match else None


def _cells(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metrics of a row that are there."""
    known = {key: row[key] for key in METRIC_KEYS if row[key] is not None and np.isfinite(row[key])}
    return {"status": row["status"], "values": dict(zip(known, rounded(list(known.values()), 4), strict=True))}


def _trajectory(folder: Path, row: Mapping[str, Any]) -> Trajectory | None:
    return trajectory_of(folder, str(row["key"])) if row["status"] == "ok" else None


def _world(folder: Path, key: str, worst: Worst) -> tuple[World | None, str]:
    """Return the world of a stored row, made again, or why it cannot be made."""
    from cellslam.sim.world import prepare

    with reading(folder) as database:
        query = "SELECT w.tables FROM rows r JOIN worlds w ON w.id = r.world WHERE r.key = ?"
        (text,) = database.execute(query, (key,)).fetchone()
    try:
        scenario = from_tables(json.loads(text), code=False)
        if unasked := scenario.radio.unasked():
            named = ", ".join(f"{key} = '{name}'" for key, name in unasked.items())
            what = "a file" if unasked.keys() <= {*FILES} else "code"
            raise InputError(f"it names {what}, {named}, which 'report --load' loads")
        return prepare(scenario.world, worst.seed, worst.trial), ""
    except InputError as error:
        return None, f"The world cannot be made again: {error}."


def _disagrees(world: World, found: Mapping[str, Trajectory]) -> bool:
    """Return whether stored errors are not those against the truth of this world."""
    truth = world.drive.poses
    for one in found.values():
        if len(one.poses) != len(truth):
            return True
        if len(one.error_m) == len(truth):
            error = np.hypot(*(one.poses[:, :2] - truth[:, :2]).T)
            if np.nanmax(np.abs(error - one.error_m)) > AGREES_M:
                return True
    return False


def _bound(found: Mapping[str, Trajectory], steps: Ints) -> list[float | None]:
    known = next((one.bound_std_m for one in found.values() if len(one.bound_std_m)), np.empty(0))
    curve: list[float | None] = rounded(known[steps], 3) if len(known) else []
    return curve
