"""What estimators assume of a recording by the options of a command, what they make of it, and what speaks against."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.departure import worse_than_odometry
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.progress_bars import bars
from cellslam.recordings.fitting.assumptions import Assumptions, assumed
from cellslam.recordings.importing.manifest import tables_of
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.external_options import LOAD_LIMIT_S
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError
from cellslam.sim.lte.radio_config import NAMING
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Recording

TABLES = ("estimator", "noise")
ALONE = "dead-reckoning"


def assumed_by(
    arguments: Namespace,
    recording: Recording,
    origin: Origin,
    names: Sequence[str],
    bar: Progress,
    limit_s: float = LOAD_LIMIT_S,
) -> Assumptions:
    """Return what estimators `names` assume by the arguments of a command, and where these say nothing by the
    recording (`assumed`). Raises InputError.
    """
    fit = False if arguments.fit is None and arguments.options else arguments.fit
    changes = parse_all(arguments.sets)
    external = [key for key in changes if key.partition(".")[0] not in TABLES and key not in NAMING]
    if external:
        raise InputError(
            f"--set {external[0]}: a recording is as it is; 'estimator.NAME.key' can be set, and the odometry's data "
            "sheet, as 'noise.u_psi.noise_density'"
        )
    from_file = dict(_options_of(Path(arguments.options))) if arguments.options else {}
    return assumed(recording, origin, names, from_file | changes, fit, bar, limit_s)


def estimates_by(
    arguments: Namespace, recording: Recording, path: Path, names: Sequence[str]
) -> tuple[Recording, list[TrialResult], bool]:
    """Return the recording with the data sheet that its estimators assume, what each of `names` makes of it, as
    `cellslam replay` of the file does, and whether the sheet was to be learnt. Raises InputError where one fails.
    """
    origin = Origin.of(recording, path, parse_all(arguments.sets))
    seed = origin.seed if arguments.seed is None else arguments.seed
    results = []
    with bars(arguments.quiet) as progress, ExternalProcesses() as external:
        given = assumed_by(arguments, recording, origin, names, progress)
        recording = replace(recording, odometry_model=given.odometry_model)
        drive = trials.Drive(origin.name, origin.trial, seed, recording)
        for request in given.requests:
            outcome = trials.outcome_of(drive, request, external, progress)
            if outcome.result is None:
                raise InputError(f"--estimator {request.name} failed on {path}: {outcome.row['error']}")
            results.append(outcome.result)
    return recording, results, given.fitted


def warnings_by(recording: Recording, results: Sequence[TrialResult], fitted: bool) -> dict[str, list[str]]:
    """Return by estimator what speaks against its estimate (`worse_than_odometry`).

    `recording` has the data sheet that estimators assume, which was to be learnt if `fitted`.
    """
    (request,) = resolve({}, (ALONE,), ())
    alone = estimate(recording, request, np.random.default_rng(0))
    return {r.estimator: worse_than_odometry(recording, r, alone, fitted) for r in results if r.estimator != ALONE}


def _options_of(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a file of options with their values, as "estimator.NAME.option". Raises InputError."""
    tables = tables_of(path)
    for name, table in tables.items():
        if name not in TABLES or not isinstance(table, Mapping):
            raise InputError(f"--options {path}: has '{name}'; it takes tables [estimator.NAME] and [noise.COMPONENT]")
        for part, keys in table.items():
            if not isinstance(keys, Mapping):
                raise InputError(f"--options {path}: [{name}] has '{part}'; name its table, as in [{name}.{part}]")
            yield from ((f"{name}.{part}.{key}", value) for key, value in keys.items())
    if not any(keys for table in tables.values() for keys in table.values()):
        raise InputError(f"--options {path}: has no table [estimator.NAME] or [noise.COMPONENT]")
