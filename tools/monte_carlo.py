"""`python -m tools monte-carlo`: how fast sweeps are, what they add to the work itself, and how fast tables are."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cellslam.benchmarks.sweeps.executors import executor, one_thread
from cellslam.benchmarks.sweeps.store import DATABASE, Store, statuses, writing
from cellslam.benchmarks.sweeps.sweeping import carry_out, seconds_of
from cellslam.benchmarks.sweeps.tasks import Plan, plan
from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.child_process import shares
from cellslam.benchmarks.trials.trials import DEFAULT_ESTIMATORS, check_counts
from cellslam.cli.arguments import DONE, SET_HELP, add, whole
from cellslam.progress_bars import bars
from cellslam.scenarios import sweep_points as sweeps
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress

LIMIT_S = 3600.0
WARM_SEED = 1
VARIANTS = 20


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("scenario", metavar="SCENARIO", nargs="?", default="tiny", help="what to run (default: tiny)")
    add(parser, "--set", help=SET_HELP.format("estimator.fastslam.particles=300"))
    add(parser, "--estimator")
    parser.add_argument("--trials", metavar="N", type=whole, default=200, help="trials to time (default: 200)")
    parser.add_argument("--jobs", metavar="N", type=whole, default=2, help="processes to compare with one (default: 2)")
    rows_help = "rows of the store that 'table' is timed with (default: 100000)"
    parser.add_argument("--rows", metavar="N", type=whole, default=100_000, help=rows_help)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON on stdout, nothing else")


def command(arguments: Namespace) -> int:
    """Carry out `python -m tools monte-carlo`."""
    check_counts(arguments.trials, 0)
    if arguments.jobs < 1:
        raise InputError(f"--jobs {arguments.jobs}: must be at least 1")
    if arguments.rows < VARIANTS:
        raise InputError(f"--rows {arguments.rows}: must be at least {VARIANTS}")
    asked = sweeps.Sweep(arguments.scenario, parse_all(arguments.sets))
    points = sweeps.points(asked, arguments.estimators or DEFAULT_ESTIMATORS)
    found: dict[str, Any] = {"scenario": points[0].scenario.name, "trials": arguments.trials}
    found |= {"estimators": [r.name for r in points[0].requests], "jobs": arguments.jobs, "cores": os.cpu_count()}
    with tempfile.TemporaryDirectory() as folder, bars(arguments.quiet or arguments.json) as progress:
        place = Path(folder)
        found |= parts(points)
        found |= rates(points, arguments.trials, arguments.jobs, place, progress)
        found |= table_time(place / "one", arguments.rows, place / "many")
    load = os.getloadavg()[0]
    found["load_at_end"] = round(load, 1)
    sys.stdout.write(json.dumps(found, indent=1) + "\n" if arguments.json else _said(found))
    return DONE


def parts(points: tuple[sweeps.Point, ...]) -> dict[str, Any]:
    """Return the seconds of one trial by part: its world with the bound, and each estimator."""
    with one_thread(shares(1, LIMIT_S)) as external:
        _, seconds = seconds_of(plan(points, 1, 0), external)
    return {"seconds_by_part": {name: round(s, 4) for name, s in seconds.items()}}


def rates(points: tuple[sweeps.Point, ...], count: int, jobs: int, place: Path, progress: Progress) -> dict[str, Any]:
    """Return trials a second of one process and of `jobs` warm ones, and what a sweep adds to the work itself."""
    made, few = plan(points, count, 0), plan(points, 2 * jobs, WARM_SEED)
    out: dict[str, Any] = {}
    limits = shares(jobs, LIMIT_S)
    for name, executor_name in (("one", "serial"), ("several", "processes")):
        with executor(executor_name, jobs, limits) as pool, writing(place / name, "bench", {}) as store:
            with progress(f"warming up ({executor_name})", len(few)) as advance:
                carry_out(few, store, pool, lambda *_, advance=advance: advance(1))
            with progress(f"{count} trials ({executor_name})", len(made)) as advance, _inner() as inner:
                begin, cpu = time.perf_counter(), time.process_time()
                carry_out(made, store, pool, lambda *_, advance=advance: advance(1))
                seconds, own = time.perf_counter() - begin, time.process_time() - cpu
            out[f"{executor_name}_seconds"] = round(seconds, 3)
            if name == "one":
                out["overhead_ms_per_trial"] = round(1e3 * (own - inner["cpu_s"]) / count, 2)
            else:
                out["driver_ms_per_trial"] = round(1e3 * own / count, 2)
            if any(status != "ok" for status in statuses(store.folder).values()):
                raise InputError("a trial failed: these times mean nothing; 'cellslam sweep' says what is wrong")
    return {**out, "ratio": round(out["serial_seconds"] / out["processes_seconds"], 3)}


def table_time(source: Path, count: int, out: Path) -> dict[str, Any]:
    """Return how long `cellslam table`, the whole command, takes for a store of `count` rows made of copies."""
    _multiply(source, count, out)
    begin, cpu = time.perf_counter(), _children_cpu_s()
    words = [sys.executable, "-P", "-c", "from cellslam.cli.main import main; raise SystemExit(main())"]
    subprocess.run([*words, "table", str(out)], check=True, capture_output=True)
    seconds = time.perf_counter() - begin
    used = _children_cpu_s() - cpu
    return {"table_rows": count, "table_seconds": round(seconds, 3), "table_cpu_seconds": round(used, 3)}


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _multiply(source: Path, count: int, out: Path) -> None:
    """Fill a store with copies of the rows of another, as of 20 variants of their world."""
    import sqlite3

    with sqlite3.connect(source / DATABASE) as database:
        row = dict(zip(*_first(database), strict=True))
        (world,) = database.execute("SELECT tables FROM worlds").fetchone()
        options = database.execute("SELECT id, tables FROM options").fetchall()
    database.close()
    known = json.loads(world)
    names = [f"{row['world'][:-3]}{n:03d}" for n in range(VARIANTS)]
    worlds = {
        name: json.dumps({**known, "radio": {**known["radio"], "clutter_scale": 1.0 + n}})
        for n, name in enumerate(names)
    }
    with writing(out, "bench", {}) as store:
        store.declare(Plan((), worlds, dict(options)))
        _insert(store, row, names, count)


def _insert(store: Store, row: Mapping[str, Any], names: list[str], count: int) -> None:
    columns = ", ".join(f'"{key}"' for key in row)
    marks = ", ".join(f":{key}" for key in row)
    copies = (
        {
            **row,
            "key": f"{n:032d}",
            "world": names[n % VARIANTS],
            "trial": n // VARIANTS,
            "position_rmse_m": n % 997 / 99,
        }
        for n in range(count)
    )
    with store.database:
        store.database.executemany(f"INSERT INTO rows ({columns}) VALUES ({marks})", copies)


def _first(database: Any) -> tuple[list[str], tuple[Any, ...]]:
    cursor = database.execute("SELECT * FROM rows LIMIT 1")
    return [column[0] for column in cursor.description], cursor.fetchone()


@contextmanager
def _inner() -> Iterator[dict[str, float]]:
    """Count this process's time inside what makes worlds, bounds and estimates: what is outside, the sweep adds."""
    from cellslam.benchmarks.bound import cramer_rao as bound
    from cellslam.scenarios import simulation

    spent = {"cpu_s": 0.0}
    places = [(simulation, "simulate"), (bound, "bound"), (trials, "outcome_of")]
    real = {name: getattr(module, name) for module, name in places}

    def counted(function: Any) -> Any:
        def call(*words: Any, **named: Any) -> Any:
            begin = time.process_time()
            try:
                return function(*words, **named)
            finally:
                spent["cpu_s"] += time.process_time() - begin

        return call

    for module, name in places:
        setattr(module, name, counted(real[name]))
    try:
        yield spent
    finally:
        for module, name in places:
            setattr(module, name, real[name])


def _said(found: Mapping[str, Any]) -> str:
    serial, several = found["serial_seconds"], found["processes_seconds"]
    named = ", ".join(f"{name} {1e3 * s:.0f} ms" for name, s in found["seconds_by_part"].items())
    lines = (
        f"{found['scenario']}, {found['trials']} trials of {', '.join(found['estimators'])}",
        f"one trial by part: {named}",
        f"one process:    {serial:.2f} s, {found['trials'] / serial:.2f} trials/s",
        f"{found['jobs']} warm processes: {several:.2f} s, {found['trials'] / several:.2f} trials/s, "
        f"{found['ratio']:.2f} x one process",
        f"added by the sweep to a trial's own work: {found['overhead_ms_per_trial']:.1f} ms in the worker "
        f"(packing, store), {found['driver_ms_per_trial']:.1f} ms in the driver of the processes",
        f"table of {found['table_rows']} rows: {found['table_seconds']:.2f} s, the whole command "
        f"({found['table_cpu_seconds']:.2f} s of processor time)",
        f"machine: {found['cores']} cores, load average {found['load_at_end']} at the end",
    )
    return "\n".join(lines) + "\n"
