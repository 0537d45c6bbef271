"""What the stages of a drive cost: processor seconds of one core for the world, the bound, and each estimator.

    python -m tools stages tiny lund-530 --rounds 5
    python -m tools stages lund-530 --set radio.front_end=signal --estimator dead-reckoning
    python -m tools stages lund-530 --before ../before/.venv/bin/python

With `--before`, the same is done by the Python of another checkout, in turn, so that whatever else the machine does
slows both alike; the ratio is the median over rounds. A drive's world, bound and default estimators together make
drives per core second.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from typing import Any

ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
DEFAULT = ("ekf-slam", "fastslam", "dead-reckoning")


def seconds(scenario: str, overrides: dict[str, Any], estimators: list[str], seed: int) -> dict[str, float]:
    """Return the processor seconds of each stage of a drive."""
    import numpy as np

    import cellslam
    from cellslam.benchmarks.bound.merged_paths import both_bounds
    from cellslam.benchmarks.trials.estimation import estimate, warm_up
    from cellslam.scenarios.estimator_options import resolve

    begin = time.process_time()
    recording = cellslam.simulate(scenario, seed, overrides=overrides)
    made = time.process_time()
    both_bounds(recording)
    found = {"world": made - begin, "bound": time.process_time() - made}
    for request in resolve(cellslam.load(scenario, overrides).estimator, tuple(estimators)):
        warm_up(request)
        begin = time.process_time()
        estimate(recording, request, np.random.default_rng(seed))
        found[request.name] = time.process_time() - begin
    return found


def serve() -> None:
    """Answer each line of standard input, the arguments of `seconds` as JSON, on standard output, compiled before."""
    for line in sys.stdin:
        print(json.dumps(seconds(**json.loads(line))), flush=True)


class Checkout:
    """A process of a checkout's Python that answers for its stages."""

    def __init__(self, python: str) -> None:
        self.child = subprocess.Popen(
            [python, "-P", __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **ONE_THREAD},
            text=True,
        )  # fmt: skip

    def seconds(self, **asked: Any) -> dict[str, float]:
        """Return what `seconds` does there."""
        assert self.child.stdin is not None and self.child.stdout is not None
        self.child.stdin.write(json.dumps(asked) + "\n")
        self.child.stdin.flush()
        found: dict[str, float] = json.loads(self.child.stdout.readline())
        return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("scenario", nargs="+")
    parser.add_argument("--set", action="append", default=[], dest="sets", metavar="KEY=VALUE")
    parser.add_argument("--estimator", action="append", default=[], dest="estimators", metavar="NAME")
    parser.add_argument("--rounds", type=int, default=3, help="drives to time, of seeds from 1 on (default: 3)")
    parser.add_argument("--before", metavar="PYTHON", help="the Python of another checkout, to compare with")


def command(asked: argparse.Namespace) -> int:
    """Measure, and print a line for each stage."""
    from cellslam.scenarios.overrides import parse_all

    overrides, estimators = dict(parse_all(asked.sets)), asked.estimators or list(DEFAULT)
    checkouts = [Checkout(python) for python in (asked.before, sys.executable) if python]
    for scenario in asked.scenario:
        rows: list[list[dict[str, float]]] = []
        for seed in range(asked.rounds + 1):
            drive = {"scenario": scenario, "overrides": overrides, "estimators": estimators, "seed": seed}
            rows.append([{**row, "drive": sum(row.values())} for row in (one.seconds(**drive) for one in checkouts)])
        print_table(scenario, rows[1:])  # the first round compiles
    return 0


def print_table(scenario: str, rows: list[list[dict[str, float]]]) -> None:
    """Print median seconds of the stages, of each checkout, of `rows` by round and checkout."""
    print(f"{scenario}, {len(rows)} drives; seconds of a core (drives per core second)")
    for stage in rows[0][0]:
        columns = [[row[stage] for row in of_one] for of_one in zip(*rows, strict=True)]
        middle = [statistics.median(column) for column in columns]
        ratio = [f"x {statistics.median(a / b for a, b in zip(*columns, strict=True)):.2f}"] if len(columns) > 1 else []
        print("  ".join([f"{stage:16}", *(f"{one:9.4f} ({1.0 / one:8.3f})" for one in middle), *ratio]), flush=True)


if __name__ == "__main__":
    serve()
