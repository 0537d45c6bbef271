"""What the pages and docstrings name of the tree is there: files, rooms, modules, functions."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CONTRIBUTING.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md")))
ROOMS = ("sim", "slam", "scenarios", "benchmarks")
CODE = re.compile(r"```.*?```|`[^`\n]+`", re.S)
WORD = re.compile(r"[\w./*-]+")
IMPORT = re.compile(r"from (cellslam[\w.]*) import ([\w, ]+)")
DATA = re.compile(r"\.(csv|gpx|h5|html|json|png|sqlite|toml)$")
# What is written as if it were in a module of that name: tables of scenarios and recordings, variables.
KEYS = (
    "city", "env", "errors", "links", "measurements", "odometry", "reference", "sites", "tables", "traffic", "trial",
    "vehicle", "world",
)  # fmt: skip
NOT_HERE = (
    "agent.py",
    "coasting.py",
    "my_parts.py",
    "ppo.py",
    "cellslam.estimators",
    "docs/notebooks/first_drive.ipynb",
)  # the reader's; a group of entry points


@cache
def paths() -> frozenset[str]:
    """Return every file and folder of the tree, from the root and from every folder above it."""
    found = [
        *ROOT.glob("*"),
        *(p for top in (*ROOMS, "cellslam", "tests", "docs", "tools", "studies") for p in (ROOT / top).rglob("*")),
    ]
    parts = [p.relative_to(ROOT).parts for p in found if "__pycache__" not in p.parts]
    return frozenset("/".join(p[i:]) for p in parts for i in range(len(p)))


@cache
def names() -> dict[str, set[str]]:
    """Return the names in each module and room, by its dotted and by its last name."""
    out: dict[str, set[str]] = {}
    for path in [*(ROOT / "cellslam").rglob("*.py"), *(p for room in ROOMS for p in (ROOT / room).rglob("*.py"))]:
        parts = ("cellslam", *(part for part in path.relative_to(ROOT).with_suffix("").parts if part != "cellslam"))
        text = path.read_text("utf-8")
        held = set(re.findall(r"^ *(?:def|class) (\w+)|^(\w+)(?:: [^=]+)? =", text, re.M))
        held = {name for pair in held for name in pair}
        if parts[-1] == "__init__":
            parts = parts[:-1]
            held = {*re.findall(r"\w+", text), *(p.stem for p in path.parent.iterdir())}
        for name in (".".join(parts), parts[-1]):
            out.setdefault(name, set()).update(held)
    out["cellslam"].update(ROOMS)
    return out


def is_there(word: str) -> bool:
    """Return whether a word of code, if it names something of the tree, names what is there."""
    module, _, name = word.rpartition(".")
    if word in NOT_HERE:
        return True
    if word.endswith((".py", "_kernel")) or re.match(rf"({'|'.join(ROOMS)}|tests|docs)/", word):
        path = word.removesuffix("/")
        return "*" in path or path in paths() or f"{path}.py" in paths()
    if word.startswith("cellslam.") or module.endswith("_kernel"):
        return word in names() or name in names().get(module, ())
    return module not in names() or module in KEYS or DATA.search(word) is not None or name in names()[module]


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_what_is_there(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    code = CODE.findall(text)
    words = {word.rstrip(".") for part in code for word in WORD.findall(part)}
    words |= {f"{module}.{name.strip()}" for module, many in IMPORT.findall(text) for name in many.split(",")}
    assert sorted(word for word in words if not is_there(word)) == []


def test_docstrings_name_pages_and_tests_that_are_there() -> None:
    sources = [p for top in (*ROOMS, "cellslam", "tests") for p in (ROOT / top).rglob("*.py") if p != Path(__file__)]
    named = {w for p in sources for w in re.findall(r"\b(?:docs|tests)/[\w./-]+\.(?:md|py)\b", p.read_text("utf-8"))}
    assert len(named) > 5
    assert sorted(word for word in named if word not in paths()) == []


@pytest.mark.parametrize("word", ["sim/rays/tracing.py", "tracing.py", "update_kernel", "cellslam.sim.rays.trace"])
def test_a_wrong_name_is_noticed(word: str) -> None:
    assert is_there(word)
    assert not is_there(word.replace("trac", "trak").replace("update", "updating"))
