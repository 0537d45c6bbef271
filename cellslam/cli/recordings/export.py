"""`cellslam export`: a recording or an estimate for other tools."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import DONE, add_options_file
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.scores.trial_result import TrialResult
    from cellslam.recordings.exporting.maps import Place
from cellslam.cli.recordings.write_at_once import at_once

TABLES = ("csv", "mat")
EXPORTS = (*TABLES, "tum", "geojson", "ply", "html", "calibration")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    format_help = "csv and mat: a folder; others: a file; may be repeated, each with its own --out"
    parser.add_argument("--format", choices=EXPORTS, action="append", required=True, dest="formats", help=format_help)
    out_help = "the folder or file to write"
    parser.add_argument("--out", metavar="PATH", action="append", required=True, dest="outs", help=out_help)
    origin_help = "geojson: where on the Earth the zero of the recording's frame lies, as in --origin=-33.86,151.21"
    parser.add_argument("--origin", metavar="LAT,LON", type=_degrees, help=origin_help)
    estimator_help = "export what this estimator makes of it (default: the truth or the reference)"
    parser.add_argument("--estimator", metavar="NAME", help=estimator_help)
    set_help = "change one option, as in estimator.fastslam.particles=300; may be repeated"
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="sets", help=set_help)
    add_options_file(parser)
    parser.add_argument("--seed", metavar="S", type=int, help="seed of the estimator (default: the recording's own)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam export`. The estimator drives once, whatever the number of formats."""
    from cellslam.recordings.exporting.maps import placement

    path, name = Path(arguments.file), arguments.estimator
    if len(arguments.formats) != len(arguments.outs):
        raise InputError(f"{len(arguments.formats)} --format and {len(arguments.outs)} --out: give each format its own")
    targets = [(kind, Path(out)) for kind, out in zip(arguments.formats, arguments.outs, strict=True)]
    for kind, out in targets:
        if kind in TABLES and name:
            raise InputError(
                f"--format {kind} writes the recording itself: leave --estimator out, or use tum, geojson, ply"
            )
        if kind == "html" and not name:
            raise InputError("--format html plays back an estimate: say which --estimator, as in --estimator fastslam")
        if kind == "calibration" and not name:
            raise InputError("--format calibration is a CSV file of what an estimator found: say --estimator ekf-slam")
        if kind not in TABLES:
            check_file(out)
    recording = Recording.load(path)
    place = placement(recording, arguments.origin) if "geojson" in arguments.formats else None
    result = _estimate(arguments, recording, path) if name else None
    for kind, out in targets:
        _write(kind, out, recording, result, place)
    return DONE


def _write(kind: str, out: Path, recording: Recording, result: TrialResult | None, place: Place | None) -> None:
    from cellslam.recordings.exporting import maps as export_maps
    from cellslam.recordings.exporting import tables as export_tables

    if kind in TABLES:
        (export_tables.write_csv if kind == "csv" else export_tables.write_mat)(recording, out)
        return
    if kind in ("geojson", "ply") and result is not None and result.vts is None:
        raise InputError(f"--estimator {result.estimator} makes no map: use one that does, as fastslam or ekf-slam")
    if kind == "html":
        assert result is not None
        from cellslam.benchmarks.report.playback import write_playback

        at_once(out, lambda file: write_playback(recording, result, file))
        return
    if kind == "calibration":
        assert result is not None
        if result.calibration is None:
            raise InputError(f"--estimator {result.estimator} finds no calibration: use ekf-slam or fastslam")
        calibration = result.calibration
        at_once(out, lambda file: export_tables.write_calibration(calibration, recording.provenance, file))
        return
    data = export_maps.shown(recording, result)
    writers: dict[str, Callable[[Path], None]] = {
        "tum": lambda file: export_maps.tum(data, file),
        "ply": lambda file: export_maps.ply(data, file),
    }
    if place is not None:
        writers["geojson"] = lambda file: export_maps.geojson(data, place, file)
    at_once(out, writers[kind])


def _degrees(text: str) -> tuple[float, float]:
    """Return latitude and longitude in degrees. Raises ArgumentTypeError."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"'{text}' is no LATITUDE,LONGITUDE in degrees, as in 55.71,13.21") from None
    if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0):
        raise ArgumentTypeError(f"'{text}' is out of range: latitude first, in degrees")
    return latitude, longitude


def _estimate(arguments: Namespace, recording: Recording, path: Path) -> TrialResult:
    from cellslam.cli.recordings.estimator_options import estimate_by

    return estimate_by(arguments, recording, path, [arguments.estimator]).results[0]
