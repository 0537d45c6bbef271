"""`cellslam check-estimator`: the conformance checks on one estimator, and what to fix."""

from __future__ import annotations

import sys
import traceback
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.estimation import warm_up
from cellslam.cli.arguments import DONE, FAILED, SET_HELP, add
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.overrides import apply, parse_all
from cellslam.slam.conformance.checks import CHECKS, Check
from cellslam.slam.conformance.subject import ConformanceError, Subject, tiny_drive

EXAMPLES = ("check-estimator my_module:MyEstimator",)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="MODULE:CLASS", help="your class, or the name of a known estimator")
    add(parser, "--set", help=SET_HELP.format("estimator.fastslam.particles=300"))


def command(arguments: Namespace) -> int:
    """Print a line for each check; exit status 1 if one has failed."""
    overrides = parse_all(arguments.sets)
    tables = apply({"estimator": {}}, overrides)["estimator"]
    (request,) = resolve(tables, (arguments.estimator,), overrides)
    try:
        warm_up(request)
    except Exception as error:
        print(f"FAIL  starts\n      {_explained(error)}")
        return FAILED
    failed = 0
    for number, one in enumerate(CHECKS, 1):
        title = one.__name__.replace("_", " ")
        _show_on_terminal(arguments.quiet, f"check {number} of {len(CHECKS)}: {title}")
        finding = finding_of(one, request)
        failed += finding is not None
        _show_on_terminal(arguments.quiet, "")
        print(f"ok    {title}" if finding is None else f"FAIL  {title}\n      {finding}", flush=True)
    found = f"{failed} of {len(CHECKS)} checks found something to fix"
    print(f"{request.name}: {found if failed else f'all {len(CHECKS)} checks passed'}")
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


def _show_on_terminal(quiet: bool, text: str) -> None:
    """Show what goes on, on a terminal's last line."""
    if not quiet and sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()
