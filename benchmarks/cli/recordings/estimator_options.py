"""What `replay` and `export` change of a recording: options of estimators, the odometry's data sheet."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellslam.benchmarks.recordings.importing.data_sheet import changed_sheet
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError
from cellslam.sim.recording import OdometryModel, Recording

TABLES = ("estimator", "noise")


def estimator_overrides(arguments: Namespace) -> dict[str, Any]:
    """Return the options of `--options` and `--set` by dotted key; those of `--set` win. Raises InputError."""
    return {key: value for key, value in _given(arguments).items() if key.startswith("estimator.")}


def data_sheet(arguments: Namespace, recording: Recording) -> OdometryModel:
    """Return the recording's odometry model with what `--options` and `--set` say of `noise`. Raises InputError."""
    given = {key: value for key, value in _given(arguments).items() if key.startswith("noise.")}
    return changed_sheet(recording.odometry_model, given)


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
