"""Loading of scenarios: a preset by name or a .toml file, with overrides.

A file may name another one as its `base`, and has what it changes there: tables key by key, items of lists by name.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from cellslam.scenarios.estimator_options import option_keys, stated
from cellslam.scenarios.keys import names_file, validate
from cellslam.scenarios.overrides import apply, dotted
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.data_files import text_of, toml_of
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.lte.statistical.statistics import with_digest
from cellslam.sim.own_code import is_loaded

PRESETS = Path(__file__).with_name("presets")
OF_ITSELF = ("name", "title", "description", "facts")  # what a file says of itself, and not of those it is the base of


def load(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None, code: bool = True) -> Scenario:
    """Return the preset of that name, or the scenario of that .toml file, with `overrides` by dotted key.

    Files that a scenario file names are looked for beside it first, and then in the current directory. `code`: whether
    code that it names may be loaded (`from_tables`). Raises InputError with what is wrong and what is allowed: unknown
    scenario or key, value out of range.
    """
    return from_tables(tables_of(name_or_path), overrides, "" if _is_preset(name_or_path) else str(name_or_path), code)


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
    return tuple(sorted(path.stem for path in PRESETS.glob("*.toml")))


def _is_preset(name_or_path: str | Path) -> bool:
    return str(name_or_path) in preset_names()


def tables_of(name_or_path: str | Path, changed_by: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Return the tables of a preset or a scenario file, with those of its base that it leaves as they are.

    `changed_by`: the files whose base it is. Raises InputError where one cannot be read, or is its own base.
    """
    text = str(name_or_path)
    path = PRESETS / f"{text}.toml" if _is_preset(text) else Path(text)
    if not (text.endswith(".toml") or len(path.parts) > 1 or (_exists(path) and path.is_file())):
        raise InputError(f"{unknown_name('scenario', text, preset_names())}; or give a .toml file")
    tables = {"name": path.stem, **_beside(path.parent, _tables(path))}
    base = tables.pop("base", None)
    return tables if base is None else _changed(path, base, tables, changed_by)


def _changed(path: Path, base: Any, tables: dict[str, Any], changed_by: tuple[Path, ...]) -> dict[str, Any]:
    """Return the tables of a file that changes its base by `tables`."""
    here = path.resolve()
    if here in changed_by:
        raise InputError(f"{path}: base = '{base}': the file is its own base")
    if not isinstance(base, str):
        raise InputError(f"{path}: base = {base!r}: must be a preset's name, or the path of a file, seen from this one")
    below = tables_of(base if _is_preset(base) else path.parent / base, (*changed_by, here))
    own = {key: tables.pop(key) for key in OF_ITSELF if key in tables}
    try:
        return own | apply({key: below[key] for key in below if key not in OF_ITSELF}, dict(dotted(tables)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


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
