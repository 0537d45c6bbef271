"""The sections of a report's worst trials: what each estimator said, in the world made again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.report.choice import rounded
from cellslam.benchmarks.report.scene import Cities, scene_of
from cellslam.benchmarks.scores.metrics import METRIC_KEYS
from cellslam.benchmarks.sweeps.store import reading, trajectory_path
from cellslam.benchmarks.sweeps.tasks import identity, scenario_of
from cellslam.benchmarks.sweeps.trajectories import Trajectory, unpack
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats, Ints

if TYPE_CHECKING:
    from cellslam.benchmarks.figures.sweep.sweep_data import SweepData
    from cellslam.benchmarks.report.worst_trials import Worst
    from cellslam.sim.world import World

STEPS = 300
# A stored error may differ by this much from the one in the world that is made again (stored in single precision).
AGREES_M = 0.02


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
        "vts": rounded(_finite(one.vt_m).T, 1),
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
    values = {key: row[key] for key in METRIC_KEYS}
    numbers = {k: rounded([v], 4)[0] for k, v in values.items() if v is not None and np.isfinite(v)}
    return {"status": row["status"], "values": numbers}


def _trajectory(folder: Path, row: Mapping[str, Any]) -> Trajectory | None:
    path = trajectory_path(folder, str(row["key"]))
    return unpack(path) if row["status"] == "ok" and path.exists() else None


def _world(folder: Path, key: str, worst: Worst) -> tuple[World | None, str]:
    """Return the world of a stored row, made again, or why it cannot be made."""
    from cellslam.sim.world import prepare

    with reading(folder) as database:
        query = "SELECT w.tables FROM rows r JOIN worlds w ON w.id = r.world WHERE r.key = ?"
        (text,) = database.execute(query, (key,)).fetchone()
    try:
        return prepare(scenario_of(text).world, worst.seed, worst.trial), ""
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


def _finite(points: Any) -> Floats:
    return np.asarray(points, np.float64).reshape(-1, 3)
