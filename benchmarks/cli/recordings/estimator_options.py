"""Options of estimators on a recording, for `replay` and `export`: those of `--options` and `--set`."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError


def estimator_overrides(arguments: Namespace) -> dict[str, Any]:
    """Return the options of `--options` and `--set` by dotted key; those of `--set` win. Raises InputError."""
    sets = parse_all(arguments.sets)
    foreign = [key for key in sets if not key.startswith("estimator.")]
    if foreign:
        raise InputError(f"--set {foreign[0]}: a recording is as it is; replay can set 'estimator.NAME.key' only")
    return (_options_of(Path(arguments.options)) if arguments.options else {}) | sets


def _options_of(path: Path) -> dict[str, Any]:
    try:
        tables = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"--options {path}: not TOML ({error}); correct it there") from error
    except OSError as error:
        raise InputError(f"--options {path}: cannot be read ({error.strerror})") from error
    estimators = tables.get("estimator")
    other = next((name for name in tables if name != "estimator"), "")
    if other or not isinstance(estimators, Mapping) or not all(isinstance(t, Mapping) for t in estimators.values()):
        what = f"has '{other}'" if other else "has no table [estimator.NAME]"
        raise InputError(f"--options {path}: {what}; it takes tables [estimator.NAME] alone, as fit-noise prints them")
    return {f"estimator.{name}.{key}": value for name, table in estimators.items() for key, value in table.items()}
