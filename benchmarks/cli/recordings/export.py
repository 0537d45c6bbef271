"""`cellslam export`: a recording or an estimate for other tools."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.cli.arguments import DONE, add_options_file
from cellslam.benchmarks.cli.progress_bars import bars
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.cli.recordings.write_at_once import at_once

EXPORTS = ("csv", "mat", "tum", "geojson", "ply", "html")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    parser.add_argument("--format", choices=EXPORTS, required=True, help="csv and mat: a folder; others: a file")
    parser.add_argument("--out", metavar="PATH", required=True, help="the folder or file to write")
    estimator_help = "export what this estimator makes of it (default: the truth or the reference)"
    parser.add_argument("--estimator", metavar="NAME", help=estimator_help)
    set_help = "change one option, as in estimator.fastslam.particles=300; may be repeated"
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="sets", help=set_help)
    add_options_file(parser)
    parser.add_argument("--seed", metavar="S", type=int, help="seed of the estimator (default: the recording's own)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam export`."""
    from cellslam.benchmarks.recordings.exporting import maps as export_maps
    from cellslam.benchmarks.recordings.exporting import playback
    from cellslam.benchmarks.recordings.exporting import tables as export_tables

    path, out, kind = Path(arguments.file), Path(arguments.out), arguments.format
    recording = Recording.load(path)
    if kind in ("csv", "mat"):
        if arguments.estimator:
            raise InputError(
                f"--format {kind} writes the recording itself: leave --estimator out, or use tum, geojson, ply"
            )
        write = export_tables.write_csv if kind == "csv" else export_tables.write_mat
        write(recording, out)
        return DONE
    check_file(out)
    if kind == "html" and not arguments.estimator:
        raise InputError("--format html plays back an estimate: say which --estimator, as in --estimator fastslam")
    result = _estimate(recording, path, arguments) if arguments.estimator else None
    if kind == "html" and result is not None:
        at_once(out, lambda place: playback.write_page(recording, result, place))
        return DONE
    data = export_maps.shown(recording, result)
    if kind in ("geojson", "ply") and result is not None and result.vts is None:
        raise InputError(f"--estimator {arguments.estimator} makes no map: use one that does, as fastslam or ekf-slam")
    writers: dict[str, Callable[[Path], None]] = {
        "tum": lambda place: export_maps.tum(data, place),
        "geojson": lambda place: export_maps.geojson(data, recording, place),
        "ply": lambda place: export_maps.ply(data, place),
    }
    at_once(out, writers[kind])
    return DONE


def _estimate(recording: Recording, path: Path, arguments: Namespace) -> TrialResult:
    """Return the estimate that `cellslam replay` of this file would make."""
    from cellslam.benchmarks.cli.recordings.estimator_options import estimator_overrides
    from cellslam.benchmarks.trials import trials
    from cellslam.benchmarks.trials.guests import Guests
    from cellslam.scenarios import foreign_options
    from cellslam.scenarios.overrides import apply
    from cellslam.scenarios.recording_origin import Origin

    overrides = estimator_overrides(arguments)
    origin = Origin.of(recording, path)
    tables = apply({"estimator": origin.options}, overrides)["estimator"]
    request = foreign_options.requests(tables, [arguments.estimator], overrides)[0]
    seed = origin.seed if arguments.seed is None else arguments.seed
    with bars(arguments.quiet) as progress, Guests() as guests:
        drive = trials.Drive(recording)
        outcome = trials.outcome_of(drive, origin.name, request, origin.trial, seed, guests, progress)
    if outcome.result is None:
        raise InputError(f"--estimator {arguments.estimator} failed on {path}: {outcome.row['error']}")
    return outcome.result
