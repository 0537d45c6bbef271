"""What map builders make of worlds that nobody modelled, as documented, beside odometry alone and a batch solution.

    python -m tools foreign-worlds
    python -m tools foreign-worlds --worlds 100-109 --estimator ekf-slam --no-fit

A world is drawn from its number (`tools.foreign_drives`). Those of the table, 0 to 19, are reported and nothing is ever
tuned on them: develop with numbers from 100 on. The batch solution (`tools.foreign_batch`) is given the right model and
the associations. Errors are horizontal, of the whole drive, in metres, with the NEES (2 where an estimator is
consistent) in brackets. What counts are the worlds in which the batch solution is better than odometry alone.
"""

from __future__ import annotations

import resource
import time
from argparse import ArgumentParser, BooleanOptionalAction, Namespace
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellslam.cli.arguments import DONE
from cellslam.python_api import replay
from cellslam.recordings import build
from cellslam.sim.errors import InputError
from cellslam.sim.progress import silent
from tools.foreign_batch import batch_rmse
from tools.foreign_drives import world

ALONE, ESTIMATORS = "dead-reckoning", ("ekf-slam", "fastslam", "bp-slam", "wall-slam")
CONSISTENT = (1.0, 5.0)  # NEES of an estimator that knows about how good it is


@dataclass(frozen=True)
class Result:
    """RMSE (m) and NEES by estimator, and the RMSE of the batch solution."""

    rmse: dict[str, float]
    nees: dict[str, float]
    batch: float

    @property
    def solvable(self) -> bool:
        """Whether the batch solution is better than odometry alone."""
        return self.batch < self.rmse[ALONE]


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("--worlds", metavar="N-M", default="0-19", help="numbers of the worlds (default: %(default)s)")
    parser.add_argument("--estimator", action="append", dest="estimators", metavar="NAME", help="may be repeated")
    parser.add_argument("--fit", action=BooleanOptionalAction, help="learn the sizes of errors (default: as replay)")


def command(arguments: Namespace) -> int:
    """Print a line a world, and what they come to."""
    first, _, last = arguments.worlds.partition("-")
    if not (first.isdigit() and (last or first).isdigit()):
        raise InputError(f"--worlds {arguments.worlds}: give a number, or two as in 0-19")
    names = tuple(arguments.estimators or ESTIMATORS)
    results = []
    for number in range(int(first), int(last or first) + 1):
        begin = time.perf_counter()
        results.append(result(number, names, arguments.fit))
        print(
            f"{line(number, results[-1])}  {time.perf_counter() - begin:.0f} s\n    {world(number).traits}", flush=True
        )
    print()
    for name in names:
        print(verdict(name, results))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GB")
    return DONE


def result(number: int, names: Sequence[str], fit: bool | None) -> Result:
    """Return what estimators `names` make of a world."""
    drawn = world(number)
    recording = build(drawn.campaign)
    rows = replay(recording, (*names, ALONE), 0, fit=fit, progress=silent).set_index("estimator")
    failed = rows[rows["status"] != "ok"]
    for name, row in failed.iterrows():
        print(f"{number}: {name} failed: {row['error']}")
    rmse, nees = (rows[key].to_dict() for key in ("position_rmse_m", "nees_mean"))
    return Result(rmse, nees, batch_rmse(drawn, recording))


def line(number: int, found: Result) -> str:
    """Return a world's results in a line."""
    own = (f"{name} {found.rmse[name]:.2f} ({found.nees[name]:.1f})" for name in found.rmse if name != ALONE)
    return f"{number:4d}  odometry {found.rmse[ALONE]:.2f}  batch {found.batch:.2f}  {'  '.join(own)}"


def verdict(name: str, results: Sequence[Result]) -> str:
    """Return in how many worlds an estimator does what it should."""
    solvable = [found for found in results if found.solvable]
    rmse, nees = (np.array([getattr(found, key)[name] for found in solvable]) for key in ("rmse", "nees"))
    alone, batch = (np.array(values) for values in zip(*((f.rmse[ALONE], f.batch) for f in solvable), strict=True))
    consistent = (nees >= CONSISTENT[0]) & (nees <= CONSISTENT[1])
    return (
        f"{name:15} of {len(solvable)}: better than odometry in {(rmse < alone).sum()}, within 2 times the batch in "
        f"{(rmse < 2.0 * batch).sum()}, NEES {CONSISTENT[0]:g} to {CONSISTENT[1]:g} in {consistent.sum()}; median of "
        f"RMSE / batch {np.median(rmse / batch):.1f}, RMSE / odometry {np.median(rmse / alone):.2f}"
    )
