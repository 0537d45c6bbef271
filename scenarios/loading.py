"""Loading of scenarios: a preset by name or a .toml file, with overrides."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from cellslam.scenarios.estimator_options import option_keys, stated
from cellslam.scenarios.keys import names_file, validate
from cellslam.scenarios.overrides import apply
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.data_files import text_of, toml_of
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.lte.statistical.statistics import with_digest
from cellslam.sim.own_code import is_loaded


def load(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None, code: bool = True) -> Scenario:
    """Return the preset of that name, or the scenario of that .toml file, with `overrides` by dotted key.

    Files that a scenario file names are looked for beside it first, and then in the current directory. `code`: whether
    code that it names may be loaded (`from_tables`). Raises InputError with what is wrong and what is allowed: unknown
    scenario or key, value out of range.
    """
    name, data, source = _read(name_or_path)
    return from_tables({"name": name, **data}, overrides, source, code)


def from_tables(
    data: Mapping[str, Any], overrides: Mapping[str, Any] | None = None, source: str = "", code: bool = True
) -> Scenario:
    """Return the scenario of plain tables, with `overrides`; `source` stands before messages about `data`.

    In another band than LTE's 20 MHz, estimators assume what its data sheet says, unless the tables do. `code` False:
    for that no waveform of one's own is loaded, and no file of constants read.
    """
    if source:
        try:
            validate(Scenario, data, suggest=option_keys)
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    scenario = validate(Scenario, apply(data, overrides or {}), suggest=option_keys)
    radio = scenario.radio
    if not code and (radio.statistics_file or not is_loaded(radio.technology)):
        return scenario
    return scenario.model_copy(update={"radio": with_digest(radio), "estimator": stated(radio, scenario.estimator)})


@cache
def preset_names() -> tuple[str, ...]:
    """Return the names of the presets, sorted."""
    found = (entry.name for entry in files("cellslam.scenarios.presets").iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


def _read(name_or_path: str | Path) -> tuple[str, dict[str, Any], str]:
    """Return name, tables and, for a file, its path for messages."""
    text = str(name_or_path)
    if text in preset_names():
        preset = files("cellslam.scenarios.presets") / f"{text}.toml"
        return text, tomllib.loads(preset.read_text("utf-8")), ""
    path = Path(text)
    if not (text.endswith(".toml") or len(path.parts) > 1 or path.is_file()):
        raise InputError(f"{unknown_name('scenario', text, preset_names())}; or give a .toml file")
    return path.stem, _beside(path.parent, _tables(path)), text


def _beside(folder: Path, value: Any) -> Any:
    """Return a value of a scenario file, in which what stands beside that file is named from the current directory."""
    if isinstance(value, list):
        return [_beside(folder, item) for item in value]
    if not isinstance(value, dict):
        return value
    return {key: _place(folder, inner) if names_file(key) else _beside(folder, inner) for key, inner in value.items()}


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # as of a name that is too long
        return False


def _place(folder: Path, name: Any) -> Any:
    return str(folder / name) if isinstance(name, str) and _exists(folder / name) else name


def _tables(path: Path) -> dict[str, Any]:
    try:
        return toml_of(text_of(path))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such scenario file; presets are {', '.join(preset_names())}") from error
    except OSError as error:
        raise InputError(f"{path}: the scenario file cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a scenario file: it is no UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a scenario file: {error} (TOML)") from error
