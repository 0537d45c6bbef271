"""`python -m tools shards`: a sweep in shards, some killed and some done twice at once, against the same in one."""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from cellslam.benchmarks.scores.metrics import COST_KEYS, ROW_KEYS
from cellslam.benchmarks.sweeps import store
from cellslam.cli.arguments import DONE, FAILED, whole
from cellslam.cli.main import main

# A drive of seconds, by estimators whose kernels start no threads: processes are forked, to spare their start.
LINE = (
    *("sweep", "tiny", "--set", "vehicle.distance_m=5", "--set", "vehicle.duration_s=7.5", "--set", "vehicle.stops=0"),
    *("--set", "vehicle.stand_first_s=0", "--sweep", "vehicle.snapshot_interval_s=0.05,0.15", "--executor", "serial"),
    *("--estimator", "dead-reckoning", "--estimator", "ekf-slam", "--quiet"),
)
SEED = 1


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    for name, value, what in (
        ("shards", 64, "shards"), ("killed", 8, "shards that are killed at a random moment, then done again"),
        ("doubled", 2, "shards that two processes do at the same time"), ("trials", 64, "trials of each of two worlds"),
        ("jobs", 2, "shards at the same time"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", metavar="N", type=whole, default=value, help=f"{what} (default: {value})")


def command(arguments: Namespace) -> int:
    """Carry out `python -m tools shards`."""
    store.CHECKPOINT_S = 0.0  # a copy after each row: the most that this can cost
    line, count, rng = [*LINE, "--trials", str(arguments.trials)], arguments.shards, random.Random(SEED)
    with tempfile.TemporaryDirectory() as folder:
        one, many = Path(folder, "one"), Path(folder, "many")
        main([*line, "--out", folder + "/warm", "--trials", "1"])
        cpu = time.process_time()
        main([*line, "--out", str(one)])
        cpu_s = time.process_time() - cpu
        numbers = rng.sample(range(1, count + 1), count)
        lines = {n: [*line, "--out", str(many), "--shard", f"{n}/{count}"] for n in numbers}
        begin, kept = time.perf_counter(), []
        os.waitpid(_start(lines[numbers[-1]]), 0)
        seconds = time.perf_counter() - begin
        for n in numbers[: arguments.killed]:
            child = _start(lines[n])
            time.sleep(rng.uniform(0.0, seconds))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            kept.append(len(_rows(many / f"shard-{n}-of-{count}")))
        doubled = numbers[arguments.killed : arguments.killed + arguments.doubled]
        calm = [lines[n] for n in numbers[-(count // 2) : -1]]
        spent = _all([lines[n] for n in (*numbers, *doubled)], calm, arguments.jobs)
        failures = [what for what in ("rows", "table", "trajectories") if _kept(one, what) != _kept(many, what)]
        if main(["merge", str(many)]) != DONE:
            failures.append("merge")
        failures += [f"merged {what}" for what in ("rows", "table") if _kept(one, what) != _kept(many, what)]
    print(f"killed shards had kept so many rows: {kept}")
    more = spent / len(calm) - cpu_s / count
    print(f"a shard takes {more:.2f} s of processor time beside its work, with a copy each row, but for its start")
    print(f"differing: {', '.join(failures)}" if failures else "rows, tables and trajectories are those of one")
    return FAILED if failures else DONE


def _start(line: Sequence[str]) -> int:
    """Carry out a command line in a process of its own, and return its number."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        os._exit(main(line))
    return child


def _all(lines: list[list[str]], timed: list[list[str]], jobs: int) -> float:
    """Carry out command lines, some at the same time; return the processor time of those that are timed, in s."""
    running: dict[int, list[str]] = {}
    # The same twice stands side by side.
    waiting, spent = sorted(lines, key=lambda line: line[-1]), 0.0
    while waiting or running:
        while waiting and len(running) < max(jobs, 2):
            line = waiting.pop()
            running[_start(line)] = line
        child, _, usage = os.wait3(0)
        spent += usage.ru_utime + usage.ru_stime if running.pop(child) in timed else 0.0
    return spent


def _rows(folder: Path) -> list[Any]:
    results = (key for key in ROW_KEYS if key not in COST_KEYS)
    kept = ", ".join(("key", "world", "options", "trajectory_sha256", *results))
    if not store.databases(folder):
        return []
    with store.reading(folder) as database:
        return database.execute(f"SELECT {kept} FROM rows ORDER BY key").fetchall()


def _kept(folder: Path, what: str) -> Any:
    """Return what a folder has of one kind, to compare."""
    if what == "rows":
        return _rows(folder)
    if what == "trajectories":
        return {file.name: file.read_bytes() for file in (folder / store.TRAJECTORIES).rglob("*.npz")}
    text = StringIO()
    with redirect_stdout(text):
        main(["table", str(folder), "--format", "csv", "--metric", "position_rmse_m", "--interval"])
    return text.getvalue()
