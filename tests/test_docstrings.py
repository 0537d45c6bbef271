"""Public functions on arrays say the shapes and units of what they take and return, and where they come from."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ROOMS = ("sim", "slam", "scenarios", "benchmarks")
WANTED = 0.98
ARRAY = re.compile(r"\b(Floats|Ints|Bools|Complexes|NDArray|ArrayLike|ndarray)\b")
NUMBERS = re.compile(r"\b(Floats|Complexes|ArrayLike|ndarray)\b|NDArray\[np\.(float|complex)\d+\]|NDArray\[Any\]")
# (T, 6), (n,), (..., 3), (L + 1,), (2, 2, ages)
SIZE = r"(\.\.\.|\w+( ?[-+*/]? ?\w+)?)"
SHAPE = re.compile(rf"\({SIZE},( ?{SIZE},?)*\)|\bshape\b|\bscalars?\b")
UNIT = re.compile(
    r"(?<![\w'`])(m|mm|km|metres?|s|ms|us|ns|seconds?|rad|radians|deg|degrees|dB|dBm|mW|Hz|kg|m/s|rad/s|m\^2|rad\^2|"
    r"samples?|snapshots?|wavelengths?|pixels?|\w+_(m|s|rad|db|hz|deg|mps|m2|rad2))(?![\w'`])|"
    r"\b(no unit|without unit|any unit|same unit|unit of|units|dimensionless|unit vectors?|probabilit(y|ies)|log-\w+|"
    r"logs?|weights?|shares?|indices|index|counts?|rows)\b"
)
# Rooms that carry out published methods: there each function's docstring, or its module's, gives a source.
METHODS = ("sim/rays", "sim/lte", "sim/nr", "sim/waveform", "slam", "benchmarks/bound", "benchmarks/scores")
SOURCE = re.compile(r"\bSources?:")


class Function(NamedTuple):
    """A public function that takes or returns arrays; `around`: what its class and its module say."""

    place: str
    text: str
    numbers: bool
    around: str


def public_functions() -> Iterator[Function]:
    """Yield the public functions and methods on arrays of all rooms."""
    for path in sorted(p for room in ROOMS for p in (ROOT / room).rglob("*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        for owner, node in _members(tree):
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            said = [ast.unparse(a.annotation) for a in arguments if a.annotation is not None]
            said += [ast.unparse(node.returns)] if node.returns is not None else []
            if any(ARRAY.search(text) for text in said):
                scope = f"{owner.name}." if isinstance(owner, ast.ClassDef) else ""
                place = f"{path.relative_to(ROOT)}:{node.lineno} {scope}{node.name}"
                numbers = any(NUMBERS.search(text) for text in said)
                around = f"{ast.get_docstring(owner)} {ast.get_docstring(tree)}"
                yield Function(place, ast.get_docstring(node) or "", numbers, around)


def _members(owner: ast.Module | ast.ClassDef) -> Iterator[tuple[ast.Module | ast.ClassDef, ast.FunctionDef]]:
    """Yield the public functions of a module and of its public classes, each with what it stands in."""
    for node in owner.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield owner, node
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _members(node)


def lacking(functions: list[Function], found: Callable[[Function], object]) -> list[str]:
    """Return the places of the functions that have not what is looked for, none if they are few enough."""
    places = [f.place for f in functions if not found(f)]
    return places if len(places) > (1 - WANTED) * len(functions) else []


def states_unit(function: Function) -> bool:
    """Return whether a docstring has a unit, shapes aside."""
    return UNIT.search(SHAPE.sub("", function.text)) is not None


def test_shapes_are_stated() -> None:
    functions = list(public_functions())
    assert len(functions) > 250
    assert lacking(functions, lambda f: SHAPE.search(f.text)) == []


def test_units_are_stated() -> None:
    functions = [f for f in public_functions() if f.numbers]
    assert len(functions) > 200
    assert lacking(functions, states_unit) == []


def test_methods_give_their_source() -> None:
    functions = [f for f in public_functions() if f.place.startswith(METHODS)]
    assert len(functions) > 100
    assert lacking(functions, lambda f: SOURCE.search(f"{f.text} {f.around}")) == []


def test_the_patterns_tell_what_is_stated_from_what_is_not() -> None:
    def states(text: str) -> bool:
        return states_unit(Function("", text, True, ""))

    assert SHAPE.search("Return poses (T, 6).") and not SHAPE.search("Return the poses (sorted).")
    assert states("Distances (m,) in m.") and states("Poses (6,): m and rad.")
    assert not states("Distances (m,) of the vehicle's paths.")
    assert SOURCE.search("Source: TS 36.211, clause 6.10.1.") and not SOURCE.search("As is well known.")
