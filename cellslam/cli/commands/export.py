"""`cellslam export`: a recording or an estimate for other tools."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.trials.output_files import at_once, check_file, write_tum
from cellslam.cli.arguments import REPEATED, add
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.scores.trial_result import TrialResult
    from cellslam.recordings.exporting.maps import Place

EXAMPLES = (
    "export tiny.h5 --format csv --out tables",
    "export tiny.h5 --estimator ekf-slam --format mcap --out drive.mcap",
    "export tiny.h5 --estimator fastslam --format tum --out t.tum",
)
TABLES = ("csv", "mat")
EXPORTS = (*TABLES, "tum", "square", "mcap", "geojson", "ply", "html", "calibration")
OF_ESTIMATES = {  # formats that need an --estimator, and why
    "html": "plays back an estimate: say which --estimator, as in --estimator fastslam",
    "calibration": "is a CSV file of what an estimator found: say --estimator ekf-slam",
    "square": "holds what an estimator claims: say which, as in --estimator ekf-slam",
}


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "file", "--accept-changed")
    format_help = "csv and mat: a folder; others: a file; may be repeated, each with its own --out"
    parser.add_argument("--format", choices=EXPORTS, required=True, dest="formats", help=format_help, **REPEATED)
    add(parser, "--out", metavar="PATH", required=True, dest="outs", help="the folder or file to write", **REPEATED)
    origin_help = "geojson: where on the Earth the zero of the recording's frame lies, as in --origin=-33.86,151.21"
    parser.add_argument("--origin", metavar="LAT,LON", type=_degrees, help=origin_help)
    estimator_help = "export what this estimator makes of it (default: the truth or the reference)"
    parser.add_argument("--estimator", metavar="NAME", help=estimator_help)
    add(parser, "--set", help="change one option, as in estimator.fastslam.particles=300; may be repeated")
    add(parser, "--options", "--fit")
    add(parser, "--seed", default=None, help="seed of the estimator (default: the recording's own)")


def command(arguments: Namespace) -> None:
    """The estimator drives once, whatever the number of formats."""
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
        if kind in OF_ESTIMATES and not name:
            raise InputError(f"--format {kind} {OF_ESTIMATES[kind]}")
        if kind not in TABLES:
            check_file(out)
    recording, result = Recording.load(path, arguments.accept_changed), None
    place = placement(recording, arguments.origin) if "geojson" in arguments.formats else None
    if name:
        from cellslam.cli.recording_estimates import estimates_by

        _, (result,), _ = estimates_by(arguments, recording, path, [name])
    for kind, out in targets:
        if kind in TABLES:
            from cellslam.recordings.exporting import tables

            tables.write_tables(recording, out, kind)
        else:
            _check_result(kind, result)
            with at_once(out) as file:
                _write(kind, recording, result, place, file)
            if kind == "tum" and result is not None and not result.smoothed:
                from cellslam.recordings.exporting.covariances import write_side_file

                with at_once(out.with_name(f"{out.name}.cov")) as file:
                    write_side_file(file, recording.time_s, result.poses, result.covariances)


def _check_result(kind: str, result: TrialResult | None) -> None:
    """Raise InputError where an estimate has not what a format is for."""
    if result is not None and kind in ("geojson", "ply") and result.vts is None:
        raise InputError(f"--estimator {result.estimator} makes no map: use one that does, as fastslam or ekf-slam")
    if result is not None and kind == "calibration" and result.calibration is None:
        raise InputError(f"--estimator {result.estimator} finds no calibration: use ekf-slam or fastslam")


def _write(kind: str, recording: Recording, result: TrialResult | None, place: Place | None, file: Path) -> None:
    """Write an estimate, or without one the truth or reference."""
    from cellslam.benchmarks.report.playback import world_of, write_playback
    from cellslam.recordings.exporting import maps, tables
    from cellslam.recordings.exporting.covariances import write_square
    from cellslam.recordings.exporting.mcap_file import write_mcap

    if kind == "html" and result is not None:
        write_playback(recording, result, file)
    elif kind == "calibration" and result is not None and result.calibration is not None:
        tables.write_calibration(result.calibration, recording.provenance, file)
    elif kind == "square" and result is not None:
        write_square(file, result.estimator, recording.time_s, result.poses, result.covariances)
    elif kind == "mcap":
        world = world_of(recording)
        write_mcap(recording, result, world.scene.city if world is not None else None, file)
    elif kind == "tum":
        shown = maps.shown(recording, result)
        write_tum(file, shown.time_s, shown.poses)
    elif kind == "ply":
        maps.ply(maps.shown(recording, result), file)
    elif place is not None:
        maps.geojson(maps.shown(recording, result), place, file)


def _degrees(text: str) -> tuple[float, float]:
    """Return latitude and longitude in degrees. Raises ArgumentTypeError."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"'{text}' is no LATITUDE,LONGITUDE in degrees, as in 55.71,13.21") from None
    if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0):
        raise ArgumentTypeError(f"'{text}' is out of range: latitude first, in degrees")
    return latitude, longitude
