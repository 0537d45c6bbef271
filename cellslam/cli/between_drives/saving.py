"""What `run` and `replay` keep of one drive for the next: whose it would be, and where it is from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.scenarios.estimator_options import Request
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording


def check_saving(option: str, file: str | None, able: Sequence[str], trials: int) -> None:
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


def provenance(result: TrialResult, requests: Sequence[Request], recording: Recording) -> dict[str, Any]:
    """Return where the result of one of the requests is from."""
    (options,) = (request.options for request in requests if request.name == result.estimator)
    return {
        "estimator": result.estimator,
        "options": {} if options is None else options.model_dump(mode="json"),
        "recording": dict(recording.provenance),
    }
