"""`--calibration` and `--save-calibration` of `run` and `replay`: what is known of the array, before and after."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from cellslam.cli.between_drives.saving import check_saving, provenance
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.keys import validate
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.trials import Trial

OPTION = "calibration_file"


def add_calibration(parser: ArgumentParser) -> None:
    """Add `--calibration` and `--save-calibration`."""
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        help="begin with the array's calibration as an earlier drive of the same car found it; in a sweep: "
        "estimator.NAME.calibration_file",
    )
    parser.add_argument(
        "--save-calibration",
        metavar="FILE",
        help="keep what the estimator finds of the array's calibration, as in: run lund-530 --estimator ekf-slam "
        "--save-calibration car.h5, then: run lund-530 --estimator ekf-slam --seed 1 --calibration car.h5",
    )


def calibrated(arguments: Namespace, requests: Sequence[Request], trials: int) -> tuple[tuple[Request, ...], str]:
    """Return the requests as they begin with the calibration that was asked for, and a note of those that cannot.

    Raises InputError where none can, where the file does not suit one that can, and where it would not be clear whose
    calibration, or of which trial, is to be saved.
    """
    leaving = [r.name for r in requests if r.external or callable(getattr(r.estimator, "calibration", None))]
    check_saving("--save-calibration", arguments.save_calibration, leaving, trials)
    if arguments.calibration is None:
        return tuple(requests), ""
    able = {r.name for r in requests if r.options is not None and OPTION in type(r.options).model_fields}
    rest = ", ".join(r.name for r in requests if r.name not in able)
    if not able:
        raise InputError(f"--calibration {arguments.calibration}: {rest} cannot use it; use ekf-slam or fastslam")
    note = f"without the calibration, which it cannot use: {rest}" if rest else ""
    return tuple(_with(r, arguments.calibration) if r.name in able else r for r in requests), note


def save(arguments: Namespace, requests: Sequence[Request], trial: Trial) -> str:
    """Write the calibration that was asked for, with its provenance; return why there is none, if it is so."""
    if arguments.save_calibration is None:
        return ""
    given = [o.result for o in trial.outcomes if o.result is not None and o.result.calibration is not None]
    if len(given) != 1 or trial.recording is None:
        return (
            f"--save-calibration {arguments.save_calibration}: not written, for none was found: the estimator failed, "
            "has no such states, or the drive ended while clock offsets were wide"
        )
    (result,) = given
    assert result.calibration is not None
    about = provenance(result, requests, trial.recording)
    replace(result.calibration, provenance=about).save(arguments.save_calibration)
    return ""


def _with(request: Request, file: str) -> Request:
    assert request.options is not None
    table = {**request.options.model_dump(mode="json"), OPTION: file}
    return replace(request, options=validate(type(request.options), table, f"estimator.{request.name}."))
