"""The rooms: their order, no circles; the picture of them."""

from __future__ import annotations

import ast
import importlib.util
import re
import tomllib
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = ("sim", "slam", "scenarios", "benchmarks", "cellslam")


def picture() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_architecture", ROOT / "docs" / "draw_architecture.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PICTURE = picture()


def modules() -> dict[str, Path]:
    """Return all modules of the package by dotted name."""
    found: dict[str, Path] = {}
    for floor in FLOORS:
        for path in sorted((ROOT / floor).rglob("*.py")):
            parts = ["cellslam", *path.relative_to(ROOT / floor).with_suffix("").parts]
            parts[1:1] = [] if floor == "cellslam" else [floor]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(known: Mapping[str, Path]) -> dict[str, set[str]]:
    """Return which module imports which, in functions and for type checking too."""
    out: dict[str, set[str]] = {}
    for name, path in known.items():
        wanted = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                full = {f"{node.module}.{alias.name}" for alias in node.names}
                wanted |= {other if other in known else node.module for other in full}
        out[name] = (wanted & known.keys()) - {name}
    return out


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return a circle of a graph; none: an empty list."""
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_module_imports_in_a_circle() -> None:
    known = modules()
    assert len(known) > 300
    assert circle(imports(known)) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) != []


@pytest.mark.parametrize("floor", FLOORS)
def test_no_room_imports_in_a_circle(floor: str) -> None:
    graph = PICTURE.inside(floor, PICTURE.uses())
    assert len(graph) > 1
    assert circle(graph) == []


def test_no_module_is_left_out_of_type_checking() -> None:
    mypy = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["mypy"]
    assert mypy["strict"]
    assert [name for table in mypy["overrides"] for name in table["module"] if name.startswith("cellslam")] == []


def test_picture_is_of_the_code_as_it_is() -> None:
    assert PICTURE.PICTURE.read_text("utf-8") == PICTURE.drawn(), "run python docs/draw_architecture.py"


def test_pages_name_files_that_exist() -> None:
    for page in ("docs/explanation/architecture.md", "CONTRIBUTING.md"):
        text = (ROOT / page).read_text("utf-8")
        named = re.findall(r"`((?:sim|slam|scenarios|benchmarks|cellslam|tests|docs)/[\w/.]+)`", text)
        assert len(named) > 5
        assert [path for path in named if not (ROOT / path).exists()] == [], page
