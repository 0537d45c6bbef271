"""Sweeps whose rows are made up: for tests of what is done with rows."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.benchmarks.sweeps.store import writing
from cellslam.benchmarks.sweeps.tasks import Job, Plan, Result, Task, identity, plan
from cellslam.benchmarks.sweeps.trajectories import SHAPES, Trajectory, pack
from cellslam.scenarios import sweep_points as sweep

RowOf = Callable[[Task, Job], dict[str, Any]]
EMPTY = {**dict.fromkeys(ROW_KEYS), "scenario": "tiny", "trial": 0, "seed": 0, "status": "ok"}


def trajectory(snapshots: int = 9, sites: int = 2, vts: int = 4) -> bytes:
    sizes = {"T": snapshots, "S": sites, "V": vts, "K": vts, "2": 2, "3": 3, "6": 6}
    columns = {name: np.ones([sizes[x] for x in shape]) for name, shape in SHAPES.items()}
    return pack(Trajectory(**columns | {"time_s": np.arange(float(snapshots))}))


def plan_of(data: dict[str, Any], estimators: tuple[str, ...] = ("dead-reckoning",), trials: int = 1) -> Plan:
    return plan(sweep.points(sweep.from_tables({"scenario": "tiny", **data}), estimators), trials, 0)


def made_up(
    folder: Path, made: Plan, row: RowOf = lambda *_: {}, packed: Callable[[Task, Job], bytes | None] = lambda *_: None
) -> Path:
    """Store a row for each job of a plan: what `row` says of it, and the trajectory that `packed` returns."""
    with writing(folder, "made up", {"cellslam": "0"}) as store:
        store.declare(made)
        for task, job in ((one, job) for one in made.tasks for job in one.jobs):
            first = {"scenario": json.loads(task.world)["name"], "estimator": job.estimator, "trial": task.trial}
            result = Result(job.key, EMPTY | first | row(task, job), "", packed(task, job), job.oracle)
            store.write(result, identity(task.world), identity(job.options))
    return folder
