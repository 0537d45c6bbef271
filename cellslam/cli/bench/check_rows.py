"""`cellslam bench accuracy --check`: whether an entry's rows are what its estimators give on a sample of the drives."""

from __future__ import annotations

import math
import secrets
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cellslam.benchmarks.scores.metrics import METRIC_KEYS
from cellslam.cli.arguments import DONE, FAILED, limits
from cellslam.sim.errors import InputError

# Other versions and processors round otherwise, and an estimator's choices may hang on the last digit.
TOLERANCE = 0.01


def check(arguments: Namespace) -> int:
    """Drive a sample of an entry's drives again; print each beside what the entry says. FAILED: one differs."""
    from cellslam.benchmarks.sweeps.executors import executor
    from cellslam.benchmarks.sweeps.tasks import Lost, plan
    from cellslam.benchmarks.tables.suite_rows import read
    from cellslam.cli.sweep import processes
    from cellslam.scenarios.suites import points_of
    from cellslam.sim.world import versions

    path = Path(arguments.check)
    entry = read(path)
    said = {str(row["key"]): row for row in entry.rows.to_dict("records")}
    estimators = entry.rows["estimator"].unique().tolist()
    one = entry.suite
    each = [one.trials_of(name) for name in one.scenarios]
    made = plan(points_of(one, one.scenarios, estimators), each, one.seed, trajectories=False)
    if unknown := [job for task in made.tasks for job in task.jobs if job.key not in said]:
        raise InputError(f"{path}: {unknown[0].estimator} has other options here, or {one.name} another scenario")
    if not 1 <= arguments.sample <= len(made.tasks):
        raise InputError(f"--sample {arguments.sample}: {one.name} has 1 to {len(made.tasks)} drives")
    jobs = processes(arguments)
    # Redrawn each time: who sends an entry in cannot know which drives it will be.
    chosen = secrets.SystemRandom().sample(made.tasks, arguments.sample)
    here = {name: text for name, text in versions().items() if entry.versions.get(name) != text}
    for name, text in here.items():
        sys.stdout.write(f"{name}: {entry.versions.get(name, 'none')} in the entry, {text} here\n")
    wrong = 0
    with executor(arguments.executor, jobs, limits(arguments, jobs), arguments.scheduler) as pool:
        for answer in pool.run(chosen):
            row = said[answer.key]
            found = {"status": "failed", "error": answer.reason} if isinstance(answer, Lost) else answer.row
            differing = list(differences(row, found))
            wrong += bool(differing)
            verdict = ", ".join(differing) or "as said"
            sys.stdout.write(f"{row['estimator']}, {row['scenario']}, trial {row['trial']}: {verdict}\n")
    count = len(estimators) * len(chosen)
    sys.stdout.write(f"{count - wrong} of {count} drives are as the entry says, to {100 * TOLERANCE:g} %\n")
    return FAILED if wrong else DONE


def differences(said: Mapping[Any, Any], found: Mapping[str, Any]) -> Iterator[str]:
    """Yield in what a row differs from what was said: its status, or metrics beyond the tolerance."""
    if said["status"] != found["status"]:
        yield f"status {said['status']}, here {found['status']} ({found.get('error')})"
        return
    for key in METRIC_KEYS:
        first, second = (_number(row.get(key)) for row in (said, found))
        if math.isnan(first) != math.isnan(second) or abs(first - second) > TOLERANCE * abs(second):
            yield f"{key} {first:.4g}, here {second:.4g}"


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)
