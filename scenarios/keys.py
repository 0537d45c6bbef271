"""Every key of a configuration with its unit, range and meaning, read off the pydantic models themselves.

`validate` makes models of tables, and tells in one clear line what is wrong with one.
"""

from __future__ import annotations

import difflib
import json
import math
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cellslam.sim.errors import InputError, one_line

# Unit by the ending of a key, longest first.
UNITS = {
    "_m_per_sqrt_s": "m/sqrt(s)", "_deg_per_sqrt_s": "deg/sqrt(s)", "_deg_per_s_sqrt_s": "deg/s/sqrt(s)",
    "_deg_per_mps2": "deg/(m/s2)", "_rad_per_s": "rad/s", "_deg_per_s": "deg/s", "_percent": "%", "_per_km": "1/km",
    "_mps2": "m/s2", "_mps": "m/s", "_dbm": "dBm", "_db": "dB", "_deg": "deg", "_rad": "rad", "_hz": "Hz",
    "_m2": "m2", "_m": "m", "_s": "s",
}  # fmt: skip
BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
Suggest = Callable[[], Iterable[str]]
Model = TypeVar("Model", bound=BaseModel)
_EXPECTED = {
    "bool": "true or false", "int": "an integer", "float": "a number", "string": "text in quotes",
    "tuple": "a list [..., ...]", "list": "a list [..., ...]", "dict": "a table", "model": "a table",
}  # fmt: skip


@dataclass(frozen=True)
class Key:
    """One key as `cellslam show` lists it; `unit` and `allowed` may be empty. `changed`: it is not at its default."""

    name: str
    value: Any
    unit: str
    allowed: str
    meaning: str
    changed: bool


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
            default = field.get_default(call_default_factory=True, validated_data=vars(config))
            changed = field.is_required() or value != default
            yield Key(path, value, unit_of(name), allowed(field), field.description or "", changed)


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


def names_file(key: str) -> bool:
    """Return whether the value of a key, by its last part, is the name of a file."""
    return key in ("file", "path") or key.endswith("_file")


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
    if get_origin(annotation) is Annotated and not alone:
        inner = FieldInfo.from_annotation(annotation)
        return [f"{' '.join(_choices(inner.annotation, alone=False))} {allowed(inner)}"]
    return ["true", "false"] if annotation is bool else []


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that a field may hold: itself, the choices of a union, the items of a list."""
    if isinstance(annotation, type) and not get_args(annotation):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for part in get_args(annotation) for model in models_in(part)]


def validate(model: type[Model], data: Mapping[str, Any], prefix: str = "", suggest: Suggest = tuple) -> Model:
    """Return `data` as a frozen `model`; only integers become floats, and lists tuples.

    `prefix` stands before every key in messages, `suggest()` are further known keys. Raises InputError
    with the key, the value given, the values allowed and, for an unknown key, the nearest known one.
    """
    _refuse_unfit(data, prefix.rstrip("."))
    try:
        return model.model_validate_json(json.dumps(data, default=_plain), strict=True)
    except ValidationError as error:
        details = error.errors(include_url=False)
        # An unknown key first, as a misspelled key may show as a missing one too.
        first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
        raise InputError(_line(first, model, data, prefix, suggest)) from error


def _line(detail: ErrorDetails, model: type[BaseModel], data: Mapping[str, Any], prefix: str, suggest: Suggest) -> str:
    fields = {f"{prefix}{key}": field for key, field in known_fields(model, data).items()}
    key, value = _locate(detail["loc"], data, detail["type"] == "missing")
    if detail["type"] == "extra_forbidden":
        while isinstance(value, Mapping) and value:  # the first key of a whole table that is unknown
            name, value = next(iter(value.items()))
            key = f"{key}.{name}"
        key = f"{prefix}{key}"
        near = nearest_key(key, [*fields, *suggest()])
        return f"unknown key '{key}'" + (f"; did you mean '{near}'?" if near else "")
    if detail["type"].startswith("union_tag"):
        return _tag_line(detail, f"{prefix}{key}")
    key = f"{prefix}{key}".rstrip(".")
    field = fields.get(key)
    meaning = f" ({field.description})" if field is not None and field.description else ""
    if detail["type"] == "missing":
        return f"'{key}' is missing{meaning}"
    problem = _problem(detail, field, unit_of(key))
    if not key:
        return problem
    if isinstance(value, Mapping):
        return f"{key}: {problem}"
    shown = f"'{value}'" if isinstance(value, str) else json.dumps(value, default=str)
    return f"{key} = {shown if len(shown) <= 60 else f'{shown[:57]}...'}: {problem}{meaning}"


def _tag_line(detail: ErrorDetails, key: str) -> str:
    context = detail.get("ctx", {})
    name = f"{key}.{str(context.get('discriminator', '')).strip(chr(39))}"
    if "tag" not in context:
        return f"'{name}' is missing"
    return f"{name} = '{context['tag']}': must be {str(context['expected_tags']).replace(', ', ' or ')}"


def _problem(detail: ErrorDetails, field: FieldInfo | None, unit: str) -> str:
    """Return what the value must be: its type where that is wrong, its range or choices where known."""
    span = allowed(field) if field is not None else ""
    for name, words in _EXPECTED.items():
        if detail["type"].startswith(f"{name}_") and detail["type"].endswith(("_type", "_from_float")):
            return f"must be {words}" if not span else f"must be {span if ' or ' in span else f'{words}, {span}'}"
    if detail["type"] == "too_short":
        return f"needs at least {detail['ctx']['min_length']} items, not {detail['ctx']['actual_length']}"
    if span and detail["type"] != "value_error":
        return f"must be {span}{f' {unit}' if unit else ''}"
    text = " ".join(detail["msg"].removeprefix("Value error, ").split())
    return text[:1].lower() + text[1:]


def _locate(loc: tuple[int | str, ...], data: Any, missing: bool) -> tuple[str, Any]:
    """Return the dotted key and the value at pydantic's `loc`, which also names union members and tags."""
    parts: list[str] = []
    for index, step in enumerate(loc):
        if isinstance(data, Mapping) and step in data:
            data = data[step]
            parts.append(str(step))
        elif isinstance(data, list | tuple) and isinstance(step, int) and step < len(data):
            data = data[step]
            parts.append(label(data, step))
        elif missing and index == len(loc) - 1:
            parts.append(str(step))
    return ".".join(parts), data


def _refuse_unfit(value: Any, key: str) -> None:
    """Raise InputError for what no key holds: numbers that are not finite, texts with a NUL, as no file's name has."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _refuse_unfit(inner, f"{key}.{name}".lstrip("."))
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            _refuse_unfit(inner, f"{key}.{label(inner, index)}")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key} = {value}: must be a finite number")
    elif isinstance(value, str) and "\0" in value:
        raise InputError(f"{key} = '{one_line(value, 60)}': holds a NUL character; leave it out")


def _plain(value: Any) -> Any:
    """Return what JSON can hold for numpy scalars and arrays, paths, dates."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
