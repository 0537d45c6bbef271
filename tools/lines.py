"""Count the lines of Python, package by package: those that are installed, and those of the tests."""

from __future__ import annotations

import os
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import DONE

ROOT = Path(__file__).parents[1]
INSTALLED = ("cellslam", "sim", "slam", "scenarios", "benchmarks")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("--root", metavar="DIR", type=Path, default=ROOT, help="checkout (default: this one)")


def command(arguments: Namespace) -> int:
    """Print lines a package, and the sums."""
    sums = {}
    for folder in (*INSTALLED, "tests", "tools"):
        path = arguments.root / folder
        for package in sorted(p for p in path.iterdir() if p.is_dir() and not p.is_symlink() and count(p)):
            if folder in INSTALLED:
                print(f"{count(package):7d} {package.relative_to(arguments.root)}")
        sums[folder] = count(path)
    print(f"{sum(sums[folder] for folder in INSTALLED):7d} installed")
    for folder in ("tests", "tools"):
        print(f"{sums[folder]:7d} {folder}")
    return DONE


def count(folder: Path) -> int:
    """Return the lines of the Python files of a folder, without those behind links."""
    files = [Path(package, name) for package, _, names in os.walk(folder) for name in names if name.endswith(".py")]
    return sum(len(p.read_text("utf-8").splitlines()) for p in files)
