"""`cellslam integrity`: which alert limits estimators serve, and how often they mislead."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.scores.metrics import ALERT_LIMIT_M, RISK
from cellslam.benchmarks.sweeps.rows import oracles
from cellslam.benchmarks.sweeps.store import lost_in_words
from cellslam.benchmarks.tables.formats import integrity_grid, render
from cellslam.benchmarks.tables.integrity import DIRECTIONS, Overbound, Question, integrity
from cellslam.benchmarks.tables.summaries import Layout, row_keys
from cellslam.cli.arguments import REPEATED, add, number
from cellslam.cli.output import note

EXAMPLES = ("integrity load", "integrity load --alert-limit 1 --alert-limit 10 --overbound overbound.json")


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", "--rows", "--format")
    limit_help = f"alert limit in metres; may be repeated (default: {ALERT_LIMIT_M:g})"
    parser.add_argument("--alert-limit", metavar="M", type=number, dest="limits", help=limit_help, **REPEATED)
    risk_help = f"how often an error may exceed its protection level (default: {RISK:g})"
    parser.add_argument("--risk", metavar="P", type=number, default=RISK, help=risk_help)
    parser.add_argument("--direction", choices=DIRECTIONS, default=DIRECTIONS[0], help="of the error")
    overbound_help = "read the claims also as widened by 'fit-overbound', on drives of other seeds"
    parser.add_argument("--overbound", metavar="FILE", help=overbound_help)


def command(arguments: Namespace) -> None:
    folder = Path(arguments.folder)
    question = Question(arguments.risk, tuple(arguments.limits) or (ALERT_LIMIT_M,), arguments.direction)
    overbound = Overbound.load(Path(arguments.overbound)) if arguments.overbound else None
    keys = row_keys(folder, Layout(rows=tuple(arguments.rows) or None))
    tidy = integrity(folder, question, overbound, keys)
    note(arguments, lost_in_words(folder))
    sys.stdout.write(render(tidy, integrity_grid(tidy, keys, oracles(folder), question.risk), arguments.format))
