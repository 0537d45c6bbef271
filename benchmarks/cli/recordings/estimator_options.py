"""What `replay` and `export` change of a recording: options of estimators, the odometry's data sheet."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cellslam.benchmarks.recordings.fitting.fit_noise import UNKNOWN
from cellslam.benchmarks.recordings.fitting.fit_sizes import Learnt, learn
from cellslam.benchmarks.recordings.importing.data_sheet import changed_sheet
from cellslam.scenarios import foreign_options
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.overrides import apply, parse_all
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress
from cellslam.sim.recording import OdometryModel, Recording
from cellslam.slam.front_end.front_end_options import FrontEndOptions

TABLES = ("estimator", "noise")


@dataclass(frozen=True)
class Told:
    """What estimators are told of a recording: their requests, with all options, and the odometry's data sheet.

    `learnt`: what the recording itself gave, None if it was not asked, or could not answer (`why`).
    """

    requests: tuple[Request, ...]
    odometry_model: OdometryModel
    learnt: Learnt | None = None
    why: str = ""


def told(arguments: Namespace, recording: Recording, origin: Origin, names: Sequence[str], progress: Progress) -> Told:
    """Return what estimators `names` are told: by the recording's scenario, or by what it shows itself (`--fit`; for
    map builders on a measured one the default). What `--options` and `--set` say goes before. Raises InputError.
    """
    given = _given(arguments)
    overrides = {key: value for key, value in given.items() if key.startswith("estimator.")}
    sheet = changed_sheet(recording.odometry_model, {k: v for k, v in given.items() if k.startswith("noise.")})
    requests = _requests(origin.options, names, overrides)
    mapping = any(isinstance(r.options, FrontEndOptions) for r in requests)
    by_default = origin.measured and mapping and not arguments.options
    if not (by_default if arguments.fit is None else arguments.fit):
        return Told(requests, sheet)
    try:
        learnt = learn(replace(recording, odometry_model=sheet), origin.told(), progress)
    except InputError as error:
        learnt = Learnt(dict(UNKNOWN), sheet, {}, 0)
        return Told(_with(learnt, origin, requests, overrides), sheet, None, str(error))
    return Told(_with(learnt, origin, requests, overrides), learnt.odometry_model, learnt)


def _with(
    learnt: Learnt, origin: Origin, requests: Sequence[Request], overrides: Mapping[str, Any]
) -> tuple[Request, ...]:
    """Return the requests with the options that were learnt."""
    tables = {r.name: learnt.table(type(r.options) if r.options else None) for r in requests}
    merged = {name: {**origin.options.get(name, {}), **table} for name, table in tables.items()}
    return _requests({**origin.options, **merged}, [r.name for r in requests], overrides)


def _requests(tables: Mapping[str, Any], names: Sequence[str], overrides: Mapping[str, Any]) -> tuple[Request, ...]:
    full = apply({"estimator": tables}, overrides)["estimator"]
    return foreign_options.requests(full, names, overrides)


def _given(arguments: Namespace) -> dict[str, Any]:
    sets = parse_all(arguments.sets)
    foreign = [key for key in sets if key.partition(".")[0] not in TABLES]
    if foreign:
        raise InputError(
            f"--set {foreign[0]}: a recording is as it is; 'estimator.NAME.key' can be set, and the odometry's data "
            "sheet, as 'noise.u_psi.noise_density'"
        )
    return (_options_of(Path(arguments.options)) if arguments.options else {}) | sets


def _options_of(path: Path) -> dict[str, Any]:
    try:
        tables = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"--options {path}: not TOML ({error}); correct it there") from error
    except OSError as error:
        raise InputError(f"--options {path}: cannot be read ({error.strerror})") from error
    out: dict[str, Any] = {}
    for name, table in tables.items():
        if name not in TABLES or not isinstance(table, Mapping):
            raise InputError(f"--options {path}: has '{name}'; it takes tables [estimator.NAME] and [noise.COMPONENT]")
        for part, keys in table.items():
            if not isinstance(keys, Mapping):
                raise InputError(f"--options {path}: [{name}] has '{part}'; name its table, as in [{name}.{part}]")
            out |= {f"{name}.{part}.{key}": value for key, value in keys.items()}
    if not out:
        raise InputError(f"--options {path}: has no table [estimator.NAME] or [noise.COMPONENT]")
    return out
