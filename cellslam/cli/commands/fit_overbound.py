"""`cellslam fit-overbound`: how much what estimators claim must be widened."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.scores.metrics import RISK
from cellslam.benchmarks.tables.integrity import fit_overbound
from cellslam.benchmarks.trials.output_files import check_file, write_text
from cellslam.cli.arguments import add, number
from cellslam.cli.output import note

EXAMPLES = ("fit-overbound training --out overbound.json",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder")
    risk_help = f"risk for which the overbound is fitted (default: {RISK:g})"
    parser.add_argument("--risk", metavar="P", type=number, default=RISK, help=risk_help)
    add(parser, "--out", metavar="FILE", required=True, help="where to write it, as JSON")


def command(arguments: Namespace) -> None:
    out = Path(arguments.out)
    check_file(out)
    found = fit_overbound(arguments.folder, arguments.risk)
    write_text(out, found.text())
    for name, one in found.claims.items():
        tails = "Gaussian" if one.freedom == float("inf") else f"Student's t of {one.freedom:g} degrees of freedom"
        note(arguments, f"{name}: deviations times {one.scale:.2f}, {tails}, of {found.drives} drives")
