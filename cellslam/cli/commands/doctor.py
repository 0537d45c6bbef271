"""`cellslam doctor`: what this installation is made of, on one screen, to paste into a question."""

from __future__ import annotations

import platform
import sys
from argparse import ArgumentParser, Namespace
from collections import defaultdict
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from textwrap import fill

EXAMPLES = ("doctor",)
NAME_WIDTH, WIDTH = 18, 100
FOR_DEVELOPERS = ("test", "dev")  # extras that users have no need of


def add_arguments(parser: ArgumentParser) -> None:
    """There are none."""


def command(arguments: Namespace) -> None:
    for name, text in _facts():
        print(fill(text, WIDTH, initial_indent=f"{name:{NAME_WIDTH}}", subsequent_indent=" " * NAME_WIDTH))


def _facts() -> Iterator[tuple[str, str]]:
    from cellslam.benchmarks.sweeps.executors import cores
    from cellslam.slam.joint.ekf_slam import EkfSlam

    yield "cellslam", f"{version('cellslam')}, in {Path(__file__).parents[3]}"
    yield "python", f"{platform.python_version()}, {sys.executable}"
    yield "system", f"{platform.platform()}, {_processor()}, {cores()} cores to use"
    yield "compiled", "ekf-slam starts at once" if EkfSlam.compiled() else "not yet: the first run of ekf-slam does it"
    for title, names in _packages().items():
        yield title, ", ".join(f"{name} {_version(name)}" for name in names)


def _packages() -> dict[str, list[str]]:
    """Return the packages that cellslam requires, and those of each extra."""
    from packaging.requirements import Requirement

    found = defaultdict[str, list[str]](list)
    for required in map(Requirement, requires("cellslam") or ()):
        extra = str(required.marker).partition("extra == ")[2].strip('"') if required.marker else ""
        if extra not in FOR_DEVELOPERS:
            found[f"extra {extra}" if extra else "packages"].append(required.name)
    return found


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(not installed)"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()
