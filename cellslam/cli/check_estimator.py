"""`cellslam check-estimator`: the conformance checks on one estimator, and what to fix."""

from __future__ import annotations

import sys
import traceback
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.estimation import warm_up
from cellslam.cli.arguments import DONE, FAILED, add_set
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.overrides import apply, parse_all
from cellslam.slam.conformance.checks import CHECKS, Check
from cellslam.slam.conformance.subject import ConformanceError, Subject, tiny_drive


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("estimator", metavar="MODULE:CLASS", help="your class, or the name of a known estimator")
    add_set(parser, "estimator.fastslam.particles=300")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam check-estimator`: print a line for each check; exit status 1 if one has failed."""
    overrides = parse_all(arguments.sets)
    tables = apply({"estimator": {}}, overrides)["estimator"]
    (request,) = resolve(tables, (arguments.estimator,), overrides)
    try:
        warm_up(request)
    except Exception as error:
        sys.stdout.write(f"FAIL  starts\n      {_explained(error)}\n")
        return FAILED
    failed = 0
    for number, one in enumerate(CHECKS, 1):
        _progress(arguments.quiet, f"check {number} of {len(CHECKS)}: {_title(one)}")
        finding = finding_of(one, request)
        failed += finding is not None
        _progress(arguments.quiet, "")
        sys.stdout.write(f"ok    {_title(one)}\n" if finding is None else f"FAIL  {_title(one)}\n      {finding}\n")
        sys.stdout.flush()
    verdict = (
        f"{failed} of {len(CHECKS)} checks found something to fix" if failed else f"all {len(CHECKS)} checks passed"
    )
    sys.stdout.write(f"{request.name}: {verdict}\n")
    return FAILED if failed else DONE


def finding_of(one: Check, request: Request) -> str | None:
    """Return what a check found about a requested estimator, as lines for the user; None: nothing."""
    try:
        one(Subject(request.estimator, request.options, tiny_drive()))
    except ConformanceError as error:
        what, _, remedy = str(error).partition("; to fix: ")
        return f"{what}\n      to fix: {remedy}"
    except Exception as error:
        return _explained(error)
    return None


def _explained(error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(last.filename).name}, line {last.lineno}, in {last.name}"
    return f"{type(error).__name__}: {' '.join(str(error).split())}\n      to fix: {where}"


def _title(one: Check) -> str:
    return one.__name__.replace("_", " ")


def _progress(quiet: bool, text: str) -> None:
    """Show what goes on, on a terminal's last line."""
    if not quiet and sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()
