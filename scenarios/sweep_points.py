"""Sweeps: many variants of one scenario, from `--sweep` options or a sweep file.

A sweep is a product of axes. An axis is a list of settings, each a table of dotted keys and values that apply
together: the values of one key (grid), written-out settings (list), keys that advance together (zip), or points of
a Latin hypercube over ranges.
"""

from __future__ import annotations

import itertools
import json
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cellslam.scenarios.estimator_options import Ask, Request, called, resolve
from cellslam.scenarios.external_options import LOAD_LIMIT_S, asking
from cellslam.scenarios.keys import describe, validate
from cellslam.scenarios.loading import load, preset_names
from cellslam.scenarios.overrides import dotted, parse, parse_value, split
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.data_files import text_of, toml_of
from cellslam.sim.errors import InputError
from cellslam.slam.registry import expanded

Settings = Mapping[str, Any]
Axis = tuple[Settings, ...]
MOST_POINTS = 100_000


@dataclass(frozen=True)
class Sweep:
    """What is swept: a scenario, settings that hold for all points, and the axes; None: not given."""

    scenario: str
    overrides: Settings = field(default_factory=dict)
    axes: tuple[Axis, ...] = ()
    estimators: tuple[str, ...] = ()
    trials: int | None = None
    seed: int | None = None


@dataclass(frozen=True)
class Point:
    """One variant: the swept keys with their values, its scenario, and the estimators with their options."""

    settings: Settings
    scenario: Scenario
    requests: tuple[Request, ...]


class Range(BaseModel):
    """From `low` to `high`; on a logarithmic scale equal factors are equally likely."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    low: float = Field(description="smallest value")
    high: float = Field(description="largest value")
    scale: Literal["linear", "log"] = Field("linear", description="how values are spread")
    integer: bool = Field(False, description="round to whole numbers")


class LatinConfig(BaseModel):
    """A Latin hypercube: each range is cut into `points` equal parts, and each part is used once."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    points: int = Field(ge=1, le=MOST_POINTS, description="number of points")
    seed: int = Field(0, ge=0, description="seed of the draw")
    ranges: dict[str, Range] = Field(min_length=1, description="range of each key")


class SweepFile(BaseModel):
    """The tables of a sweep file; its parts are multiplied. Keys may be dotted or quoted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: str = Field(description="name of a preset, or path of a scenario file, seen from this file")
    estimators: tuple[str, ...] = Field((), description="estimators by name or as module:Class")
    trials: int | None = Field(None, ge=1, description="trials of each point")
    seed: int | None = Field(None, ge=0, description="root seed")
    set: dict[str, Any] = Field(default_factory=dict, description="keys with one value for all points")
    grid: dict[str, tuple[Any, ...]] = Field(default_factory=dict, description="keys with their values")
    list: tuple[dict[str, Any], ...] = Field((), description="written-out settings")
    zip: dict[str, tuple[Any, ...]] = Field(default_factory=dict, description="keys whose values go together")
    latin: LatinConfig | None = Field(None, description="Latin hypercube over ranges")


def grid_axis(text: str) -> Axis:
    """Return the axis of `KEY=V1,V2,...`; values are TOML, and bare words are text. Raises InputError."""
    key, _ = parse(text)
    values = text.partition("=")[2].strip()
    try:
        found = toml_of(f"value = [{values}]")["value"]
    except tomllib.TOMLDecodeError:
        found = [parse_value(part.strip()) for part in values.split(",")]
    if not found or "" in found:
        raise InputError(f"--sweep '{text}': write KEY=VALUE,VALUE, as in radio.detection_scale=1,0.8")
    return tuple({key: value} for value in found)


def latin_axis(config: LatinConfig) -> Axis:
    """Return the points of a Latin hypercube (McKay, Beckman, Conover, 1979). Raises InputError for a bad range."""
    from scipy.stats import qmc

    for key, span in config.ranges.items():
        if not span.low < span.high or (span.scale == "log" and span.low <= 0):
            least = "0 < low < high" if span.scale == "log" else "low < high"
            raise InputError(f"latin.ranges.{key}: low = {span.low:g}, high = {span.high:g}: needs {least}")
    unit = qmc.LatinHypercube(d=len(config.ranges), rng=np.random.default_rng(config.seed)).random(config.points)
    columns = [[_within(span, u) for u in unit[:, i].tolist()] for i, span in enumerate(config.ranges.values())]
    return tuple(dict(zip(config.ranges, row, strict=True)) for row in zip(*columns, strict=True))


def is_sweep_file(path: str | Path) -> bool:
    """Return whether `path` is a .toml file with a top-level key `scenario`, which a scenario file has not."""
    if str(path) in preset_names() or not Path(path).is_file():
        return False
    try:
        return "scenario" in toml_of(text_of(path))
    except (OSError, ValueError):
        return False


def read(path: str | Path) -> Sweep:
    """Return the sweep of a .toml file. Raises InputError with the file's name."""
    try:
        return from_tables(toml_of(text_of(path)), Path(path).parent)
    except OSError as error:
        raise InputError(f"{path}: the sweep file cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a sweep file: {error} (TOML)") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def from_tables(data: Mapping[str, Any], folder: Path = Path()) -> Sweep:
    """Return the sweep of plain tables; a scenario file is looked for from `folder`. Raises InputError."""
    flat = dict(data)
    for part in ("set", "grid", "zip"):
        if isinstance(flat.get(part), Mapping):
            flat[part] = dict(dotted(flat[part]))
    if isinstance(flat.get("list"), list):
        flat["list"] = [dict(dotted(s)) if isinstance(s, Mapping) else s for s in flat["list"]]
    latin = flat.get("latin")
    if isinstance(latin, Mapping) and isinstance(latin.get("ranges"), Mapping):
        flat["latin"] = {**latin, "ranges": dict(dotted(latin["ranges"], ends=("low", "high")))}
    config = validate(SweepFile, flat)
    known = config.scenario in preset_names() or Path(config.scenario).is_absolute()
    scenario = config.scenario if known else str(folder / config.scenario)
    return Sweep(scenario, config.set, tuple(_axes(config)), config.estimators, config.trials, config.seed)


def points(sweep: Sweep, estimators: Sequence[str], limit_s: float = LOAD_LIMIT_S) -> tuple[Point, ...]:
    """Return every point of a sweep, the last axis varying fastest; all values are validated.

    `limit_s`: of `asking`. Raises InputError for a key that is set twice, that no estimator in the sweep has, or out of
    range.
    """
    estimators = expanded(estimators)
    count = math.prod(len(axis) for axis in sweep.axes)
    if not 0 < count <= MOST_POINTS:
        raise InputError(f"the sweep has {count} points: must be 1 to {MOST_POINTS}")
    # Points that differ in the world alone have the same requests; resolving them looks through all installed packages.
    known: dict[str, tuple[Request, ...]] = {}
    out = []
    with asking(limit_s) as ask:
        _check_keys(sweep, estimators, ask)
        for combination in itertools.product(*_completed(sweep, estimators, ask)):
            settings = {key: value for setting in combination for key, value in setting.items()}
            overrides = {**sweep.overrides, **settings}
            scenario = load(sweep.scenario, overrides)
            options = json.dumps(scenario.estimator, sort_keys=True)
            if options not in known:
                known[options] = resolve(scenario.estimator, estimators, overrides, ask)
            out.append(Point(settings, scenario, known[options]))
    return tuple(out)


def _check_keys(sweep: Sweep, estimators: Sequence[str], ask: Ask) -> None:
    names, seen = called(resolve({}, estimators, ask=ask)), set[str]()
    for axis in sweep.axes:
        keys = {key for setting in axis for key in setting}
        for key in sorted(keys):
            if key in sweep.overrides:
                raise InputError(f"{key} is swept, and set to {sweep.overrides[key]!r} as well: keep one of the two")
            if key in seen:
                raise InputError(f"{key} is swept twice: write all its values once")
            name = split(key)[1] if key.startswith("estimator.") else None
            if name is not None and name not in names:
                raise InputError(f"{key} is swept, but '{name}' is not among the estimators ({', '.join(estimators)})")
        seen |= keys


def _completed(sweep: Sweep, estimators: Sequence[str], ask: Ask) -> Iterator[Axis]:
    """Yield the axes; where a setting of a list leaves out a key of another, the scenario's own value stands."""
    values: dict[str, Any] = {}
    for axis in sweep.axes:
        keys = dict.fromkeys(key for setting in axis for key in setting)
        complete = all(len(setting) == len(keys) for setting in axis)
        if not complete and not values:
            scenario = load(sweep.scenario, sweep.overrides)
            described = [*describe(scenario)]
            for request in resolve(scenario.estimator, estimators, ask=ask):
                if request.options is not None:
                    described += describe(request.options, f"estimator.{request.name}.")
            values = {key.name: key.value for key in described}
        own = {} if complete else {key: values[key] for key in keys if key in values}
        yield tuple({**own, **setting} for setting in axis)


def _axes(config: SweepFile) -> Iterator[Axis]:
    for key, values in config.grid.items():
        if not values:
            raise InputError(f"grid.{key}: needs at least one value")
        yield tuple({key: value} for value in values)
    if config.list:
        yield config.list
    if config.zip:
        lengths = {key: len(values) for key, values in config.zip.items()}
        if len(set(lengths.values())) > 1:
            each = ", ".join(f"{key} has {length}" for key, length in lengths.items())
            raise InputError(f"zip: keys need equally many values ({each})")
        yield tuple(dict(zip(config.zip, row, strict=True)) for row in zip(*config.zip.values(), strict=True))
    if config.latin is not None:
        yield latin_axis(config.latin)


def _within(span: Range, share: float) -> float | int:
    """Return the value at `share` (0 to 1) of a range."""
    if span.integer and span.scale == "linear":
        return min(int(span.low) + int(share * (int(span.high) - int(span.low) + 1)), int(span.high))
    low, high = (math.log(v) if span.scale == "log" else v for v in (span.low, span.high))
    value = low + share * (high - low)
    value = min(max(math.exp(value) if span.scale == "log" else value, span.low), span.high)
    return round(value) if span.integer else value
