"""Validation of configuration tables, and its failures as one clear line for the user."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cellslam.scenarios.keys import allowed, known_fields, label, nearest_key, unit_of
from cellslam.sim.errors import InputError

Suggest = Callable[[], Iterable[str]]
Model = TypeVar("Model", bound=BaseModel)
_EXPECTED = {
    "bool": "true or false", "int": "an integer", "float": "a number", "string": "text in quotes",
    "tuple": "a list [..., ...]", "list": "a list [..., ...]", "dict": "a table", "model": "a table",
}  # fmt: skip


def validate(model: type[Model], data: Mapping[str, Any], prefix: str = "", suggest: Suggest = tuple) -> Model:
    """Return `data` as a frozen `model`; only integers become floats, and lists tuples.

    `prefix` stands before every key in messages, `suggest()` are further known keys. Raises InputError
    with the key, the value given, the values allowed and, for an unknown key, the nearest known one.
    """
    _refuse_not_finite(data, prefix.rstrip("."))
    try:
        return model.model_validate_json(json.dumps(data, default=_plain), strict=True)
    except ValidationError as error:
        details = error.errors(include_url=False)
        # An unknown key first, as a misspelled key may show as a missing one too.
        told = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
        raise InputError(_line(told, model, data, prefix, suggest)) from error


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


def _refuse_not_finite(value: Any, key: str) -> None:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _refuse_not_finite(inner, f"{key}.{name}".lstrip("."))
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            _refuse_not_finite(inner, f"{key}.{label(inner, index)}")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key} = {value}: must be a finite number")


def _plain(value: Any) -> Any:
    """Return what JSON can hold for numpy scalars and arrays, paths, dates."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
