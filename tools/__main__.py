"""`python -m tools NAME`: measure a part of cellslam, or make again what is stored of it."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from importlib import import_module

from cellslam.cli.arguments import WRONG
from cellslam.sim.errors import InputError

TOOLS = {
    "rays": "time the ray tracer, beside Sionna RT and DiffeRT where installed",
    "front-end": "what the path estimator finds, how well, and how fast",
    "calibrate": "the constants of the statistical front end from the signal level, or their check",
    "monte-carlo": "time sweeps: rates, overhead, tables",
    "stages": "seconds of a core by stage of a drive, of two checkouts in turn",
    "shards": "a sweep in shards that are killed and done twice, against the same in one",
    "fastslam": "what FastSLAM costs by particles, states and groups, beside its ratio to the bound",
    "foreign-worlds": "map builders on worlds that nobody modelled, beside a batch solution",
    "preset-facts": "what a preset gives, measured with the ray tracer, into its file",
    "supported": "run the tests with each Python, and with the lowest and the newest dependencies",
    "fuzz": "read damaged files of every kind",
    "reliability": "kill sweeps, fill disks, damage files: what is lost",
    "lines": "count lines of code, room by room",
}


def main() -> int:
    """Carry out a tool."""
    parser = ArgumentParser(prog="python -m tools", description=__doc__)
    names = parser.add_subparsers(dest="tool", required=True)
    for name, what in TOOLS.items():
        module = import_module(f"tools.{name.replace('-', '_')}")
        one = names.add_parser(name, help=what, description=module.__doc__)
        one.add_argument("--quiet", action="store_true", help="no progress")
        module.add_arguments(one)
        one.set_defaults(command=module.command)
    arguments = parser.parse_args()
    try:
        return int(arguments.command(arguments))
    except InputError as error:
        print(f"python -m tools: {error}", file=sys.stderr)
        return WRONG


if __name__ == "__main__":
    sys.exit(main())
