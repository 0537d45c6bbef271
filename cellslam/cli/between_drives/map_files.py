"""`--map` and `--save-map`: the map that a drive begins with, and the one that it leaves."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.earlier_drives import uses_maps
from cellslam.cli.between_drives.saving import check_saving, provenance
from cellslam.scenarios.estimator_options import Request
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.trials import Trial


def add_map(parser: ArgumentParser) -> None:
    """Add `--map`."""
    parser.add_argument("--map", metavar="FILE", help="begin with the map that earlier drives left")


def add_save_map(parser: ArgumentParser) -> None:
    """Add `--save-map`."""
    parser.add_argument(
        "--save-map",
        metavar="FILE",
        help="keep the map that the drive leaves, as in: run lund-530 --estimator ekf-slam --save-map map.h5, then: "
        "run lund-530 --estimator ekf-slam --seed 1 --map map.h5",
    )


def with_map(arguments: Namespace, overrides: dict[str, Any]) -> dict[str, Any]:
    """Return the overrides of a scenario with the map that was asked for."""
    return overrides if arguments.map is None else {**overrides, "map.file": arguments.map}


def check_map(arguments: Namespace, known: bool, requests: Sequence[Request], trials: int) -> str:
    """Return a note of the estimators that cannot use a map, where there is one.

    Raises InputError where none can, and where it would not be clear whose map, or of which trial, is to be saved.
    """
    able = [request.name for request in requests if uses_maps(request)]
    check_saving("--save-map", arguments.save_map, able, trials)
    if not known:
        return ""
    rest = ", ".join(r.name for r in requests if not uses_maps(r) and not r.external)
    if not able and not any(r.external for r in requests):
        raise InputError(f"a map, but {rest} cannot use it; use ekf-slam or fastslam")
    return f"without the map, which it cannot use: {rest}" if rest else ""


def save_map(arguments: Namespace, requests: Sequence[Request], trial: Trial) -> str:
    """Write the map that was asked for, with its provenance; return why there is none, if it is so."""
    if arguments.save_map is None:
        return ""
    given = [o.result for o in trial.outcomes if o.result is not None and o.result.vt_map is not None]
    if len(given) != 1 or trial.recording is None:
        return (
            f"--save-map {arguments.save_map}: not written, for there is none: the estimator failed, or the drive "
            "ended while clock offsets were wide"
        )
    (result,) = given
    assert result.vt_map is not None
    about = {**provenance(result, requests, trial.recording), "began_with": arguments.map}
    replace(result.vt_map, provenance=about).save(arguments.save_map)
    return ""
