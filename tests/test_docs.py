"""What the pages and docstrings name of the tree is there: files, folders, modules and what is in them."""

from __future__ import annotations

import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CONTRIBUTING.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md")))
CODE = re.compile(r"```.*?```|`[^`\n]+`", re.S)
FILE = re.compile(r"\b(?:sim|slam|scenarios|benchmarks|cellslam|tests|docs|tools)/[\w/.-]+\.(?:py|md|toml|json)\b")
NAME = re.compile(r"\bcellslam(?:\.[a-zA-Z_]\w*)+")
IMPORT = re.compile(r"from (cellslam[\w.]*) import ([\w, ]+)")
ENTRY_POINTS = "cellslam.estimators"


def is_there(name: str) -> bool:
    """Return whether a dotted name is a module or something in one."""
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_what_is_there(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    code = "\n".join(CODE.findall(text))
    names = set(NAME.findall(code)) - {ENTRY_POINTS}
    names |= {
        f"{module}.{name.strip()}" for module, many in IMPORT.findall(text) for name in many.split(",") if name.strip()
    }
    assert sorted(name for name in names if not is_there(name)) == []
    assert sorted(file for file in FILE.findall(code) if not (ROOT / file).exists()) == []


def test_docstrings_name_pages_and_tests_that_are_there() -> None:
    rooms = ("sim", "slam", "scenarios", "benchmarks", "cellslam", "tests")
    sources = [path.read_text("utf-8") for room in rooms for path in (ROOT / room).rglob("*.py")]
    named = {word for text in sources for word in re.findall(r"\b(?:docs|tests)/[\w./-]+\.(?:md|py)\b", text)}
    assert len(named) > 5
    assert sorted(word for word in named if not (ROOT / word).exists()) == []


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])  # Sphinx looks after the pages of the site
def test_links_lead_somewhere(page: str) -> None:
    targets = re.findall(r"\]\(([^)\s#]+)", (ROOT / page).read_text("utf-8"))
    assert [target for target in targets if "://" not in target and not (ROOT / target).exists()] == []
