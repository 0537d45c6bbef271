"""`cellslam import`, `inspect`, `export` and `fit-noise`."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.bars import bars
from cellslam.benchmarks.cli import DONE
from cellslam.benchmarks.output import check_file
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.result import TrialResult


def import_campaign(arguments: Namespace) -> int:
    """Carry out `cellslam import`."""
    from cellslam.benchmarks.recordings.adapters import import_adapter
    from cellslam.benchmarks.recordings.importing import import_folder
    from cellslam.benchmarks.recordings.suspicions import suspicions

    out, folder = Path(arguments.out), Path(arguments.folder)
    check_file(out)
    recording = import_adapter(folder, arguments.adapter) if arguments.adapter else import_folder(folder)
    recording.save(out)
    if not arguments.quiet:
        sys.stderr.write(
            f"{out}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
            f"{len(recording.measurements)} measurements\n"
        )
        for suspicion in suspicions(recording):
            sys.stderr.write(f"suspicious: {suspicion.text}\n")
    return DONE


def inspect(arguments: Namespace) -> int:
    """Carry out `cellslam inspect`."""
    from cellslam.benchmarks.recordings.inspection import as_json, as_text, inspected

    path = Path(arguments.file)
    figure = Path(arguments.figure) if arguments.figure else path.with_suffix(".png")
    if not arguments.no_figure:
        check_file(figure)
    recording = Recording.load(path)
    found = inspected(recording)
    sys.stdout.write(as_json(found) if arguments.json else as_text(path, recording, found))
    if not arguments.no_figure:
        from cellslam.benchmarks.recordings.inspection_figure import draw

        _at_once(figure, lambda place: draw(recording, place))
        if not arguments.quiet:
            sys.stderr.write(f"figure: {figure}\n")
    return DONE


def export(arguments: Namespace) -> int:
    """Carry out `cellslam export`."""
    from cellslam.benchmarks.recordings import export_maps, export_tables, playback

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
        _at_once(out, lambda place: playback.write_page(recording, result, place))
        return DONE
    data = export_maps.shown(recording, result)
    if kind in ("geojson", "ply") and result is not None and result.vts is None:
        raise InputError(f"--estimator {arguments.estimator} makes no map: use one that does, as fastslam or ekf-slam")
    writers: dict[str, Callable[[Path], None]] = {
        "tum": lambda place: export_maps.tum(data, place),
        "geojson": lambda place: export_maps.geojson(data, recording, place),
        "ply": lambda place: export_maps.ply(data, place),
    }
    _at_once(out, writers[kind])
    return DONE


def fit_noise(arguments: Namespace) -> int:
    """Carry out `cellslam fit-noise`."""
    from cellslam.benchmarks.recordings.fit_lines import lines
    from cellslam.benchmarks.recordings.fit_noise import fit

    path = Path(arguments.file)
    recording = Recording.load(path)
    with bars(arguments.quiet) as progress:
        fitted = fit(recording, progress)
    sys.stdout.write(lines(path, recording, fitted))
    return DONE


def _estimate(recording: Recording, path: Path, arguments: Namespace) -> TrialResult:
    """Return the estimate that `cellslam replay` of this file would make."""
    from cellslam.benchmarks import trials
    from cellslam.benchmarks.cli_recording import Origin, estimator_overrides
    from cellslam.scenarios.options import resolve
    from cellslam.scenarios.overrides import apply

    overrides = estimator_overrides(arguments)
    origin = Origin.of(recording, path)
    tables = apply({"estimator": origin.options}, overrides)["estimator"]
    request = resolve(tables, [arguments.estimator], overrides)[0]
    seed = origin.seed if arguments.seed is None else arguments.seed
    with bars(arguments.quiet) as progress:
        outcome = trials.outcome_of(recording, origin.name, request, origin.trial, seed, None, progress)
    if outcome.result is None:
        raise InputError(f"--estimator {arguments.estimator} failed on {path}: {outcome.row['error']}")
    return outcome.result


def _at_once(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name first, so that nothing half-written is left behind."""
    place = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        write(place)
        place.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        place.unlink(missing_ok=True)
