"""Count the lines of Python, room by room: those that are installed, and those of the tests."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import DONE

ROOT = Path(__file__).parents[1]
INSTALLED = ("cellslam", "sim", "slam", "scenarios", "benchmarks")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("--root", metavar="DIR", type=Path, default=ROOT, help="checkout (default: this one)")


def command(arguments: Namespace) -> int:
    """Print lines a room, and the sums."""
    sums = {}
    for folder in (*INSTALLED, "tests", "tools"):
        path = arguments.root / folder
        rooms = [path] if folder == "cellslam" else sorted(p for p in path.iterdir() if p.is_dir() and count(p))
        for room in rooms if folder in INSTALLED else ():
            print(f"{count(room, deep=folder != 'cellslam'):7d} {room.relative_to(arguments.root)}")
        sums[folder] = count(path, deep=folder != "cellslam")
    print(f"{sum(sums[folder] for folder in INSTALLED):7d} installed")
    for folder in ("tests", "tools"):
        print(f"{sums[folder]:7d} {folder}")
    return DONE


def count(folder: Path, deep: bool = True) -> int:
    """Return the lines of the Python files of a folder."""
    return sum(len(p.read_text("utf-8").splitlines()) for p in (folder.rglob if deep else folder.glob)("*.py"))
