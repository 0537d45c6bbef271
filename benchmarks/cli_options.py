"""Options that several commands share."""

from __future__ import annotations

import argparse


def add_set(parser: argparse.ArgumentParser, example: str) -> None:
    """Add `--set`."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="sets",
        help=f"change one key, as in {example}; may be repeated; 'cellslam show' lists the keys",
    )


def add_options_file(parser: argparse.ArgumentParser) -> None:
    """Add `--options`."""
    parser.add_argument(
        "--options",
        metavar="FILE.toml",
        help="take estimators' options from the tables [estimator.NAME] of a file, as fit-noise prints them; "
        "--set goes before it",
    )


def add_estimators(parser: argparse.ArgumentParser) -> None:
    """Add `--estimator`."""
    parser.add_argument(
        "--estimator",
        metavar="NAME",
        action="append",
        default=[],
        dest="estimators",
        help="estimator by name or as module:Class, or all; may be repeated (default: fastslam and dead-reckoning)",
    )


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
