"""`cellslam sweep`: many variants of a scenario, many trials, in parallel, interrupted and resumed."""

from __future__ import annotations

import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from cellslam.benchmarks.sweeps.executors import cores, executor, one_thread
from cellslam.benchmarks.sweeps.shards import note_shares, shares
from cellslam.benchmarks.sweeps.store import statuses, writing, writing_shard
from cellslam.benchmarks.sweeps.sweeping import carry_out, pending, seconds_of
from cellslam.benchmarks.sweeps.tasks import Plan, options_json, plan, world_json
from cellslam.benchmarks.sweeps.watch import Tally, clock, label, watching
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.benchmarks.trials.trials import DEFAULT_ESTIMATORS, check_counts
from cellslam.cli.arguments import DONE, FAILED, INTERRUPTED, REPEATED, SET_HELP, WORK, add, limits, whole
from cellslam.cli.between_drives import with_map
from cellslam.cli.job_scripts import script, whole_command
from cellslam.cli.output import note
from cellslam.scenarios import sweep_points as sweeps
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError

EXAMPLES = ("sweep tiny --sweep radio.load=0,0.5,1 --trials 20 --out load", "sweep study.toml --out study --dry-run")
Names = Mapping[tuple[str, str, str], str]


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", help="a preset's name, a scenario file, or a sweep file")
    add(parser, "--set", help=SET_HELP.format("radio.load=0.5"))
    sweep_help = "values of one key; may be repeated: all combinations"
    parser.add_argument("--sweep", metavar="KEY=V1,V2,...", dest="sweeps", help=sweep_help, **REPEATED)
    add(parser, "--estimator", "--map")
    parser.add_argument("--trials", metavar="N", type=whole, help="trials 0 to N-1 of each point (default: 1)")
    add(parser, "--seed", default=None)
    add(parser, "--out", required=True)
    add(parser, *WORK)


def command(arguments: Namespace) -> int:
    asked = requested(arguments)
    estimators = asked.estimators or DEFAULT_ESTIMATORS
    trials, seed = 1 if asked.trials is None else asked.trials, asked.seed or 0
    check_counts(trials, seed)
    return carry(arguments, sweeps.points(asked, estimators, arguments.time_limit), trials, seed, Path(arguments.out))


def requested(arguments: Namespace) -> sweeps.Sweep:
    """Return the sweep that the arguments ask for; they come before what a sweep file says."""
    file = sweeps.is_sweep_file(arguments.scenario)
    base = sweeps.read(arguments.scenario) if file else sweeps.Sweep(arguments.scenario)
    axes = tuple(sweeps.grid_axis(text) for text in arguments.sweeps)
    return replace(
        base,
        overrides=with_map(arguments, {**base.overrides, **parse_all(arguments.sets)}),
        axes=(*base.axes, *axes),
        estimators=tuple(arguments.estimators) or base.estimators,
        trials=base.trials if arguments.trials is None else arguments.trials,
        seed=base.seed if arguments.seed is None else arguments.seed,
    )


def carry(
    arguments: Namespace, points: Sequence[sweeps.Point], trials: int | Sequence[int], seed: int, out: Path
) -> int:
    """Carry out trials 0 to `trials` - 1 of every point into the store in `out`, or estimate how long they take.

    `trials`: of each point, or one number for all.
    """
    made = plan(points, trials, seed, not arguments.no_trajectories)
    return carry_plan(arguments, made, _counted(len(points), "point"), _names(points), out)


def carry_plan(arguments: Namespace, made: Plan, of: str, names: Names, out: Path) -> int:
    """Carry out a plan into the store in `out`, or say how long it may take.

    `of`: what it is a plan of, in words; `names`: what its jobs are called.
    """
    from cellslam.sim.world import versions

    jobs = processes(arguments)
    allowed = limits(arguments, jobs)
    check_folder(out)
    if arguments.script and arguments.shard:
        raise InputError("--script is of all shards: leave out --shard")
    number, count = arguments.shard or (1, 1)
    parts = shares(made, count)
    part = parts[number - 1]
    todo = pending(part, out, arguments.retry_failed)
    if arguments.script or arguments.dry_run:
        _estimate_cost(arguments, f"{of}, {_size(part, todo)}", todo, allowed, out)
        return DONE
    note(arguments, _size(part, todo))
    stored = statuses(out)
    again = sum(stored.get(job.key) == "ok" for task in todo.tasks for job in task.jobs)
    note(arguments, f"rows done again, as their trajectory is missing or damaged: {again}" if again else "")
    whole = shlex.join(whole_command(arguments.words))
    commands = [f"{whole} --shard {n}/{count}" for n in range(1, count + 1)] if arguments.shard else [whole]
    command, tally = commands[number - 1], Tally(len(todo), names)
    opened = (
        writing_shard(out, number, count, command, versions())
        if arguments.shard
        else writing(out, command, versions(), partial(note, arguments))
    )
    try:
        if todo:  # what is finished can be asked for again where nothing can be written
            with opened as store:
                note_shares(out, dict(zip(commands, parts, strict=True)))
                pool = executor(arguments.executor, jobs, allowed, arguments.scheduler)
                with pool as workers, watching(tally, arguments.quiet, arguments.live) as on_result:
                    carry_out(todo, store, workers, on_result)
    except KeyboardInterrupt:
        kept = f"{tally.done} new rows are kept in {out}"
        sys.stderr.write(f"interrupted: {kept}; the same command goes on from there: {command}\n")
        return INTERRUPTED
    return _conclude(arguments, part, tally, out)


def _estimate_cost(arguments: Namespace, size: str, todo: Plan, allowed: Limits, out: Path) -> None:
    """Print how long a plan of that size takes, or the script that carries it out."""
    print(size, file=sys.stderr if arguments.script else sys.stdout)
    with one_thread(allowed) as external:
        seconds, parts = seconds_of(todo, external)
    if arguments.script:
        sys.stdout.write(script(arguments, len(todo.tasks), seconds, out))
    elif parts:
        jobs = processes(arguments)
        timed = ", ".join(f"{name} {clock(value)}" for name, value in parts.items())
        print(f"about {clock(seconds / jobs)} on {_counted(jobs, 'core')} (one trial, timed now: {timed})")


def _conclude(arguments: Namespace, part: Plan, tally: Tally, out: Path) -> int:
    """Say what is stored of what was asked for, and return the exit status."""
    status = statuses(out)
    failed = sum(status[job.key] == "failed" for task in part.tasks for job in task.jobs)
    first = f"the first: {next(iter(tally.errors))}" if tally.errors else "before"
    words = f", {failed} failed ({first}); --retry-failed tries them again" if failed else ""
    new = f" ({tally.done} new, in {clock(tally.seconds)})" if tally.done else ""
    shows = f"'cellslam table {shlex.quote(str(out))}' shows them"
    note(arguments, f"{len(part)} rows are in {out}{new}{words}; {shows}")
    return FAILED if failed else DONE


def in_part(arguments: Namespace) -> bool:
    """Return whether a command was asked for less than all rows, so that there is nothing to conclude from them."""
    return bool(arguments.dry_run or arguments.script or arguments.shard)


def processes(arguments: Namespace) -> int:
    """Return how many processes were asked for. Raises InputError."""
    if arguments.jobs is not None and arguments.jobs < 1:
        raise InputError(f"--jobs {arguments.jobs}: must be at least 1")
    if arguments.scheduler is not None and arguments.executor != "dask":
        raise InputError("--scheduler is for --executor dask")
    return 1 if arguments.executor == "serial" else arguments.jobs or cores()


def _size(made: Plan, todo: Plan) -> str:
    """Return in words how large a plan is, and how much of it is done already."""
    stored = len(made) - len(todo)
    already = f", {stored} of them finished already" if stored else ""
    return f"{_counted(len(made.tasks), 'world')}, {_counted(len(made), 'row')}{already}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _names(points: Sequence[sweeps.Point]) -> Names:
    """Return what a job is called in the running table: what varies, and the estimator."""
    names: dict[tuple[str, str, str], str] = {}
    for point in points:
        world = world_json(point.scenario)
        for request in point.requests:
            names.setdefault((world, request.name, options_json(request)), label(point.settings, request.name))
    return names
