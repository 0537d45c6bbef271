"""Exit statuses, and the options that several commands share."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.child_process import Limits

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130  # exit statuses


def whole(text: str) -> int:
    """Return the whole number that a text says."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None


def number(text: str) -> float:
    """Return the number that a text says."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None


def shard(text: str) -> tuple[int, int]:
    """Return number and count of the shard that a text says, as 3/64."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise argparse.ArgumentTypeError(f"'{text}' is no shard: write I/N with I from 1 to N, as in 3/64")
    return int(found[1]), int(found[2])


SET_HELP = "change one key, as in {}; may be repeated; 'cellslam show' lists the keys"
REPEATED: dict[str, Any] = {"action": "append", "default": []}
FLAG: dict[str, Any] = {"action": "store_true"}
SHARED: dict[str, dict[str, Any]] = {
    "scenario": {"metavar": "SCENARIO", "help": "name of a preset, or path of a .toml file"},
    "file": {"metavar": "FILE.h5", "help": "a recording"},
    "--accept-changed": {"help": "read the recording though it was changed since it was written", **FLAG},
    "folder": {"metavar": "DIR", "help": "folder of a run or a sweep"},
    "--set": {"metavar": "KEY=VALUE", "dest": "sets", "help": SET_HELP.format("radio.detection_scale=0.8"), **REPEATED},
    "--estimator": {
        "metavar": "NAME",
        "dest": "estimators",
        "help": "estimator by name or as module:Class, or all; may be repeated (default: fastslam, ekf-slam and "
        "dead-reckoning)",
        **REPEATED,
    },
    "--seed": {"metavar": "S", "type": whole, "default": 0, "help": "root seed of all random draws (default: 0)"},
    "--trial": {"metavar": "N", "type": whole, "default": 0, "help": "which trial to record (default: 0)"},
    "--json": {"help": "print only the rows, as one JSON array, on stdout", **FLAG},
    "--no-figures": {"help": "do not draw figures", **FLAG},
    "--out": {"metavar": "DIR", "help": "folder of the results; one that exists is resumed"},
    # What an estimator is given.
    "--options": {
        "metavar": "FILE.toml",
        "help": "take estimators' options from the tables [estimator.NAME] of a file, as fit-noise prints them, and "
        "the odometry's data sheet from its [noise.COMPONENT]; --set goes before it",
    },
    "--fit": {
        "action": argparse.BooleanOptionalAction,
        "help": "first learn the sizes of all errors from the recording (default: for measured ones, without "
        "--options)",
    },
    "--calibration": {
        "metavar": "FILE",
        "help": "begin with the array's calibration as an earlier drive of the same car found it; in a sweep: "
        "estimator.NAME.calibration_file",
    },
    "--save-calibration": {
        "metavar": "FILE",
        "help": "keep what the estimator finds of the array's calibration, as in: run lund-530 --estimator ekf-slam "
        "--save-calibration car.h5, then: run lund-530 --estimator ekf-slam --seed 1 --calibration car.h5",
    },
    "--map": {"metavar": "FILE", "help": "begin with the map that earlier drives left"},
    "--save-map": {
        "metavar": "FILE",
        "help": "keep the map that the drive leaves, as in: run lund-530 --estimator ekf-slam --save-map map.h5, then: "
        "run lund-530 --estimator ekf-slam --seed 1 --map map.h5",
    },
    # How much is done, and where.
    "--dry-run": {"help": "print how many trials there are and how long they may take; run none", **FLAG},
    "--live": {"help": "show the table of results so far, and why rows failed, every few seconds", **FLAG},
    "--retry-failed": {"help": "repeat trials that are stored as failed", **FLAG},
    "--no-trajectories": {
        "help": "store the rows alone: saves disk space, but without error curves and reports",
        **FLAG,
    },
    "--executor": {
        "choices": ("serial", "processes", "dask"),
        "default": "processes",
        "help": "what runs the trials (default: processes)",
    },
    "--jobs": {"metavar": "N", "type": whole, "help": "number of processes (default: one a core)"},
    "--scheduler": {"metavar": "ADDRESS", "help": "a running Dask scheduler, as tcp://host:8786"},
    "--shard": {
        "metavar": "I/N",
        "type": shard,
        "help": "run the I-th of N shares of the work, into a database of its own; DIR may be on a network disk, and "
        "'merge', 'watch', 'table' and the like see all shards in it",
    },
    "--script": {
        "choices": ("slurm", "pbs", "parallel"),
        "help": "time one trial now, and print a job script that works in shards of some half an hour each",
    },
    "--time-limit": {
        "metavar": "SECONDS",
        "type": number,
        "default": 3600.0,
        "help": "longest time of one trial of an estimator in a process of its own; then it is killed (default: 3600)",
    },
    "--memory-limit": {
        "metavar": "GIB",
        "type": number,
        "help": "largest memory of a process and of all that it starts (default: fair share)",
    },
    # How results are summed up.
    "--rows": {
        "metavar": "KEY",
        "help": "a line for each value of this key; may be repeated (default: estimator and all that varies)",
        **REPEATED,
    },
    "--format": {
        "choices": ("text", "md", "csv", "latex", "json"),
        "default": "text",
        "help": "csv and json have the plain numbers",
    },
}
LIMITS = ("--time-limit", "--memory-limit")
ESTIMATION = (
    "--estimator", "--json", "--no-figures", *LIMITS, "--calibration", "--save-calibration", "--map", "--save-map",
)  # fmt: skip
WORK = (
    "--dry-run", "--live", "--retry-failed", "--no-trajectories", "--executor", "--jobs", "--scheduler", *LIMITS,
    "--shard", "--script",
)  # fmt: skip


def add(parser: argparse._ActionsContainer, *names: str, **changed: Any) -> None:
    """Add arguments of `SHARED` by name; what is `changed` of them replaces what stands there."""
    for name in names:
        parser.add_argument(name, **SHARED[name] | changed)


def limits(arguments: argparse.Namespace, jobs: int) -> Limits:
    """Return the limits that were asked for, of each of `jobs` processes. Raises InputError."""
    from cellslam.benchmarks.trials.child_process import Limits, shares

    for name, value in (("time", arguments.time_limit), ("memory", arguments.memory_limit)):
        if value is not None and not value > 0:
            raise InputError(f"--{name}-limit {value:g}: must be above 0")
    fair = shares(jobs, arguments.time_limit)
    return Limits(fair.seconds, int(arguments.memory_limit * 2**30)) if arguments.memory_limit else fair
