"""A sweep in shards: each has a share of the tasks, by whole worlds, and a store of its own; machines share a folder.

share       the most expensive task first, each to the shard that costs least so far: this   `shares`
            depends on the tasks alone, so that every shard finds the same without the others
note        which rows each shard is to make, and by which command, for `watch` and `merge`  `note_shares`
work        each run of a shard does what nobody has done yet, into a database of its own    `store.writing_shard`
merge       the rows of all, as one database; what is missing, and the commands for it       `merge`, `missing`
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from cellslam.benchmarks.sweeps.store import DATABASE, SHARD, reading, statuses
from cellslam.benchmarks.sweeps.tasks import Plan, Task, identity, is_known
from cellslam.benchmarks.trials.output_files import writing
from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably

SHARES = "shares.json"
# Cost of a snapshot of a world, bound included, in that of an estimator; of lund-530. From signals it costs some 100 to
# 300 times as much. An error of a factor leaves shards unequal only where both kinds are in one sweep.
WORLD_COST = {"statistical": 1.0, "signal": 200.0}


def shares(plan: Plan, count: int) -> list[Plan]:
    """Return the plans of `count` shards, alike in expected cost; some are empty where there are fewer tasks."""
    costs = {text: _costs(text) for text in plan.worlds.values()}
    expected = [costs[task.world][0] + costs[task.world][1] * len(task.jobs) for task in plan.tasks]
    loads = [(0.0, shard) for shard in range(count)]
    members: list[list[int]] = [[] for _ in range(count)]
    # Trials of a world one after the other, so that all shards have some: what it costs is only expected.
    for place in sorted(range(len(expected)), key=lambda place: (-expected[place], plan.tasks[place].world)):
        load, shard = heapq.heappop(loads)
        members[shard].append(place)
        heapq.heappush(loads, (load + expected[place], shard))
    return [_part(plan, [plan.tasks[place] for place in sorted(own)]) for own in members]


def note_shares(folder: Path, parts: Mapping[str, Plan]) -> None:
    """Keep the keys that each command is to make, so that others see what is missing. Raises InputError."""
    keys = {command: [job.key for task in part.tasks for job in task.jobs] for command, part in parts.items()}
    content, path = json.dumps(keys).encode(), folder / SHARES
    with writing(path, "give another --out"):
        # Every shard of a sweep writes the same.
        if not path.is_file() or path.read_bytes() != content:
            write_durably(path, content)


def noted_shares(folder: Path) -> dict[str, list[str]]:
    """Return the keys that each command of the last sweep into `folder` is to make; none where it is not known."""
    path = folder / SHARES
    try:
        return dict(json_of(text_of(path))) if path.is_file() else {}
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: damaged; the command that made it makes it again") from error


def missing(folder: Path) -> dict[str, tuple[int, int]]:
    """Return how many rows are missing of how many, by the command that makes them. Raises InputError."""
    stored: Collection[str] = statuses(folder)
    counts = {line: (sum(key not in stored for key in keys), len(keys)) for line, keys in noted_shares(folder).items()}
    return {command: count for command, count in counts.items() if count[0]}


def merge(folder: Path) -> int:
    """Put the rows of all shards in `folder` into one database there; return how many. Raises InputError."""
    path = folder / DATABASE
    if not any(folder.glob(SHARD)):
        raise InputError(f"{folder}: no shards there; 'cellslam sweep ... --shard I/N --out DIR' makes them")
    if Path(f"{path}-wal").exists():
        raise InputError(f"{path}: another sweep writes there, or was ended before its time: wait, or repeat that one")
    with reading(folder) as database:
        try:
            write_durably(path, database.serialize())
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
        return int(database.execute("SELECT count(*) FROM rows").fetchone()[0])


def _part(plan: Plan, tasks: Sequence[Task]) -> Plan:
    return replace(plan, tasks=tuple(tasks), worlds={identity(task.world): task.world for task in tasks})


def _costs(world: str) -> tuple[float, float]:
    """Return what a world, and an estimator in it, are expected to cost, in the same unit."""
    if is_known(world):
        return 1.0, 1.0
    tables = json.loads(world)
    snapshots = tables["vehicle"]["duration_s"] / tables["vehicle"]["snapshot_interval_s"]
    return snapshots * WORLD_COST[tables["radio"]["front_end"]], snapshots
