"""Arguments of `cellslam import`, `inspect`, `export` and `fit-noise`; imports nothing heavy."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from cellslam.benchmarks.cli_options import add_options_file

EXPORTS = ("csv", "mat", "tum", "geojson", "ply", "html")


def _import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="FOLDER", help="folder with recording.toml and the tables that it names")
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the recording to write")
    parser.add_argument(
        "--adapter",
        metavar="NAME",
        help="instead of recording.toml: victoria-park, tampere-60ghz, or your own as module:function",
    )


def _inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout, nothing else")
    parser.add_argument("--figure", metavar="FILE.png", help="where to draw (default: the recording's name with .png)")
    parser.add_argument("--no-figure", action="store_true", help="do not draw")


def _export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    parser.add_argument("--format", choices=EXPORTS, required=True, help="csv and mat: a folder; others: a file")
    parser.add_argument("--out", metavar="PATH", required=True, help="the folder or file to write")
    estimator_help = "export what this estimator makes of it (default: the truth or the reference)"
    parser.add_argument("--estimator", metavar="NAME", help=estimator_help)
    set_help = "change one option, as in estimator.fastslam.particles=300; may be repeated"
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="sets", help=set_help)
    add_options_file(parser)
    parser.add_argument("--seed", metavar="S", type=int, help="seed of the estimator (default: the recording's own)")


def _fit(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.h5", help="a recording")


Fill = Callable[[argparse.ArgumentParser], None]
COMMANDS: tuple[tuple[str, str, str, Fill], ...] = (
    (
        "import",
        "import_campaign",
        "make a recording of measured data: tables with a recording.toml, or an adapter",
        _import,
    ),
    ("inspect", "inspect", "what is in a recording, what is missing, what looks wrong; with a figure", _inspect),
    ("export", "export", "a recording or an estimate for other tools: CSV, .mat, TUM, GeoJSON, PLY, HTML", _export),
    ("fit-noise", "fit_noise", "noise, detection and clutter as the recording itself shows them", _fit),
)
