"""Overrides of single keys: `radio.load=0.5`, `sites.A.ports=1`, `estimator.fastslam.particles=300`."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cellslam.scenarios.keys import label
from cellslam.sim.data_files import toml_of
from cellslam.sim.errors import InputError, nearest_name


def parse(text: str) -> tuple[str, Any]:
    """Return key and value of `KEY=VALUE`; the value is TOML, and a bare word is text.

    Raises InputError when there is no `=` or no key.
    """
    key, equals, value = text.partition("=")
    key = key.strip()
    if not equals or not all(part for part in key.split(".")):
        raise InputError(f"--set '{text}': write KEY=VALUE, as in radio.detection_scale=0.8")
    return key, parse_value(value.strip())


def parse_value(text: str) -> Any:
    """Return the TOML value that `text` writes, or `text` itself when it is no TOML value."""
    try:
        return toml_of(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def parse_all(texts: Sequence[str]) -> dict[str, Any]:
    """Return the overrides of several `KEY=VALUE`; the same key twice with two values is refused."""
    out: dict[str, Any] = {}
    for text in texts:
        key, value = parse(text)
        if key in out and out[key] != value:
            raise InputError(f"--set {key} is given twice, as {out[key]!r} and as {value!r}")
        out[key] = value
    return out


def split(key: str) -> list[str]:
    """Return the parts of a dotted key. A name `module:Class` of an estimator is one part, dots and all."""
    parts = key.split(".")
    if parts[0] == "estimator" and ":" in key:
        end = next(index for index, part in enumerate(parts) if ":" in part)
        parts = ["estimator", ".".join(parts[1 : end + 1]), *parts[end + 1 :]]
    return parts


def dotted(table: Mapping[str, Any], ends: Sequence[str] = (), prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and values of nested tables; a table with one of the keys `ends` is a value."""
    for name, value in table.items():
        if isinstance(value, Mapping) and not any(end in value for end in ends):
            yield from dotted(value, ends, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def apply(data: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the tables `data` in which every key of `overrides` has its new value.

    Items of a list are addressed by their name or index. Raises InputError when the path leads into a single
    value or to an item that is not there; unknown keys are left to validation.
    """
    out = copy.deepcopy(dict(data))
    for key, value in overrides.items():
        *path, last = split(key)
        if path == ["estimator"] and not isinstance(value, Mapping):
            raise InputError(f"{key}: name the estimator and its key, as in estimator.fastslam.particles")
        place: Any = out
        for depth, part in enumerate(path):
            inside = ".".join(path[: depth + 1])
            place = place[_index(place, part, inside)] if isinstance(place, list) else place.setdefault(part, {})
            if not isinstance(place, dict | list):
                raise InputError(f"{inside} is a single value ({place!r}), it has no keys")
        place[_index(place, last, key) if isinstance(place, list) else last] = value
    return out


def _index(items: list[Any], part: str, key: str) -> int:
    labels = [label(item, index) for index, item in enumerate(items)]
    if part in labels:
        return labels.index(part)
    if part.isdecimal() and int(part) < len(items):
        return int(part)
    raise InputError(f"there is no '{key}'{nearest_name(part, labels)} (known: {', '.join(labels)})")
