"""Every key of a configuration with its unit, range and meaning, read off the pydantic models themselves."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

# Unit by the ending of a key, longest first.
UNITS = {
    "_m_per_sqrt_s": "m/sqrt(s)", "_deg_per_sqrt_s": "deg/sqrt(s)", "_deg_per_s_sqrt_s": "deg/s/sqrt(s)",
    "_deg_per_mps2": "deg/(m/s2)", "_rad_per_s": "rad/s", "_deg_per_s": "deg/s", "_percent": "%", "_per_km": "1/km",
    "_mps2": "m/s2", "_mps": "m/s", "_dbm": "dBm", "_db": "dB", "_deg": "deg", "_rad": "rad", "_hz": "Hz",
    "_m2": "m2", "_m": "m", "_s": "s",
}  # fmt: skip
BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


@dataclass(frozen=True)
class Key:
    """One key as `cellslam show` lists it; `unit` and `allowed` may be empty."""

    name: str
    value: Any
    unit: str
    allowed: str
    meaning: str


def describe(config: BaseModel, prefix: str = "") -> Iterator[Key]:
    """Yield the keys of `config` and of the models inside it, dotted, in the order of declaration."""
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        path = f"{prefix}{name}"
        if isinstance(value, BaseModel):
            yield from describe(value, f"{path}.")
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            for index, item in enumerate(value):
                yield from describe(item, f"{path}.{label(item.__dict__, index)}.")
        else:
            yield Key(path, value, unit_of(name), allowed(field), field.description or "")


def known_fields(model: type[BaseModel], data: Any, prefix: str = "") -> dict[str, FieldInfo]:
    """Return the field of every dotted key (tables too) of `model`; lists have the items of `data`."""
    out: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        path, inside = f"{prefix}{name}", data.get(name) if isinstance(data, Mapping) else None
        out[path] = field
        for inner in models_in(field.annotation):
            if isinstance(inside, Sequence) and not isinstance(inside, str):
                for index, item in enumerate(inside):
                    out |= known_fields(inner, item, f"{path}.{label(item, index)}.")
            else:
                out |= known_fields(inner, inside, f"{path}.")
    return out


def label(item: Any, index: int) -> str:
    """Return how an item of a list is called in a dotted key: by its name if it has one, else by index."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) else str(index)


def unit_of(name: str) -> str:
    """Return the unit that the ending of a key states, or an empty string."""
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")


def allowed(field: FieldInfo) -> str:
    """Return the values that a field allows, in words: a range, a choice of names, or nothing known."""
    found = ((kind, getattr(item, kind, None)) for item in field.metadata for kind in BOUNDS)
    bounds = {kind: f"{value:g}" for kind, value in found if value is not None}
    span = ", ".join(f"{word} {bounds[kind]}" for kind, word in BOUNDS.items() if kind in bounds)
    if bounds.keys() == {"ge", "le"}:
        span = f"{bounds['ge']} to {bounds['le']}"
    return " or ".join(text for text in (span, *_choices(field.annotation)) if text)


def nearest_key(given: str, known: Sequence[str]) -> str:
    """Return the known dotted key most like `given`, or an empty string; the last part counts most."""
    last = given.rpartition(".")[2]

    def likeness(key: str) -> float:
        whole = difflib.SequenceMatcher(None, given, key).ratio()
        part = difflib.SequenceMatcher(None, last, key.rpartition(".")[2]).ratio()
        return max(whole, 0.3 * whole + 0.7 * part)

    best = max(known, key=likeness, default="")
    return best if best and likeness(best) >= 0.6 else ""


def _choices(annotation: Any, alone: bool = True) -> list[str]:
    if get_origin(annotation) is Literal:
        return [f"'{value}'" if isinstance(value, str) else str(value) for value in get_args(annotation)]
    if get_origin(annotation) in (Union, types.UnionType):
        parts = [_choices(part, alone=False) for part in get_args(annotation)]
        return [choice for part in parts for choice in part] if any(len(part) for part in parts[1:]) else []
    if annotation is int and not alone:
        return ["an integer"]
    return ["true", "false"] if annotation is bool else []


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that a field may hold: itself, the choices of a union, the items of a list."""
    if isinstance(annotation, type) and not get_args(annotation):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for part in get_args(annotation) for model in models_in(part)]
