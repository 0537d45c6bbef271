"""What a recording says of its origin, and the options of estimators on it: for `replay` and `export`."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.scenarios.scenario import Scenario


@dataclass(frozen=True)
class Origin:
    """What a recording says about where it comes from; a measured one may say nothing."""

    name: str
    seed: int
    trial: int
    options: Mapping[str, Any]
    scenario: Scenario | None

    @staticmethod
    def of(recording: Recording, path: Path) -> Origin:
        """Read the provenance of a recording loaded from `path`."""
        said = recording.provenance
        tables = said.get("scenario")
        if not isinstance(tables, Mapping):
            return Origin(path.stem, _count(said.get("seed")), _count(said.get("trial")), {}, None)
        try:
            scenario = from_tables(tables)
        except InputError:
            # Written by another version of the models: estimators need its options only, not its world.
            scenario = None
        name, options = str(tables.get("name", path.stem)), tables.get("estimator", {})
        return Origin(name, _count(said.get("seed")), _count(said.get("trial")), options, scenario)


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


def _count(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0
