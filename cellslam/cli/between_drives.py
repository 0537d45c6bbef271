"""What `run` and `replay` keep of one drive for the next: the array's calibration and the map."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.earlier_drives import uses_maps
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.keys import validate
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.trials import Trial

# By option: the field of an estimator's result that the option keeps, and why there may be none.
SAVED = {
    "--save-calibration": (
        "calibration",
        "for none was found: the estimator failed, has no such states, or the drive ended while clock offsets were "
        "wide",
    ),
    "--save-map": (
        "vt_map",
        "for there is none: the estimator failed, or the drive ended while clock offsets were wide",
    ),
}


def with_calibration(arguments: Namespace, requests: Sequence[Request], trials: int) -> tuple[tuple[Request, ...], str]:
    """Return the requests as they begin with the calibration that was asked for, and a note of those that cannot.

    Raises InputError where none can, where the file does not suit one that can, and where it would not be clear whose
    calibration, or of which trial, is to be saved.
    """
    leaving = [r.name for r in requests if r.external or callable(getattr(r.estimator, "calibration", None))]
    _check_saving("--save-calibration", arguments.save_calibration, leaving, trials)
    file = arguments.calibration
    if file is None:
        return tuple(requests), ""
    able = [r.name for r in requests if r.options is not None and "calibration_file" in type(r.options).model_fields]
    note = _note_without("the calibration", able, requests)
    return tuple(_beginning_with(r, file) if r.name in able else r for r in requests), note


def _beginning_with(request: Request, file: str) -> Request:
    assert request.options is not None
    table = {**request.options.model_dump(mode="json"), "calibration_file": file}
    return replace(request, options=validate(type(request.options), table, f"estimator.{request.name}."))


def with_map(arguments: Namespace, overrides: dict[str, Any]) -> dict[str, Any]:
    """Return the overrides of a scenario with the map that was asked for."""
    return overrides if arguments.map is None else {**overrides, "map.file": arguments.map}


def check_map(arguments: Namespace, known: bool, requests: Sequence[Request], trials: int) -> str:
    """Return a note of the estimators that cannot use a map, where there is one.

    Raises InputError where none can, and where it would not be clear whose map, or of which trial, is to be saved.
    """
    able = [request.name for request in requests if uses_maps(request)]
    _check_saving("--save-map", arguments.save_map, able, trials)
    able += [request.name for request in requests if request.external]
    return _note_without("the map", able, requests) if known else ""


def _note_without(what: str, able: Sequence[str], requests: Sequence[Request]) -> str:
    """Return a note of the estimators that are not `able` to use what is given. Raises InputError where none is."""
    rest = ", ".join(request.name for request in requests if request.name not in able)
    if not able:
        raise InputError(f"{what} is given, but {rest} cannot use it; use ekf-slam or fastslam")
    return f"without {what}, which it cannot use: {rest}" if rest else ""


def _check_saving(option: str, file: str | None, able: Sequence[str], trials: int) -> None:
    """Raise InputError unless exactly one of the estimators is `able` to leave what `option` keeps in a file (None: it
    is not asked for), in one trial, and the file can be written."""
    if file is None:
        return
    if trials > 1:
        raise InputError(f"{option} {file}: of one drive; leave out --trials {trials}")
    if not able:
        raise InputError(f"{option} {file}: no estimator leaves one; use ekf-slam or fastslam")
    if len(able) > 1:
        raise InputError(f"{option} {file}: of {' or '.join(able)}? name one of them with --estimator")
    check_file(Path(file), option)


def save(arguments: Namespace, requests: Sequence[Request], trial: Trial) -> list[str]:
    """Write the calibration and the map that were asked for, with their provenance; return why there is none."""
    problems = []
    for option, (field, why) in SAVED.items():
        file = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        given = [o.result for o in trial.outcomes if o.result is not None and getattr(o.result, field) is not None]
        if file is None:
            continue
        if len(given) != 1 or trial.drive.recording is None:
            problems.append(f"{option} {file}: not written, {why}")
            continue
        (result,) = given
        (options,) = (request.options for request in requests if request.name == result.estimator)
        provenance = {
            "estimator": result.estimator,
            "options": {} if options is None else options.model_dump(mode="json"),
            "recording": dict(trial.drive.recording.provenance),
        }
        began_with = {"began_with": arguments.map} if field == "vt_map" else {}
        replace(getattr(result, field), provenance=provenance | began_with).save(file)
    return problems
