"""Recipes beside pyproject.toml say the same as it: version, requirements."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
CONDA = (ROOT / "packaging" / "conda" / "meta.yaml").read_text("utf-8")


def test_versions_agree() -> None:
    assert json.loads((ROOT / ".zenodo.json").read_text("utf-8"))["version"] == PROJECT["version"]
    assert f"\nversion: {PROJECT['version']}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f'version: "{PROJECT["version"]}"' in CONDA


def test_the_changelog_begins_with_this_version() -> None:
    first = re.search(r"^## (\S+) \(", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert first is not None and first[1] == PROJECT["version"]


def test_the_paper_cites_what_its_bibliography_has_and_figures_of_the_leaderboard() -> None:
    paper = (ROOT / "packaging" / "paper.md").read_text("utf-8")
    entries = re.findall(r"^@\w+\{(\w+),", (ROOT / "packaging" / "paper.bib").read_text("utf-8"), re.M)
    assert sorted(entries) == sorted(set(re.findall(r"(?<!\w)@([a-z]\w+)", paper.partition("---\n\n")[2])))
    board = (ROOT / "docs" / "leaderboard.md").read_text("utf-8")
    lines = [line.split(" | ") for line in paper.splitlines() if line.startswith("| `")]
    assert lines
    for name, rank, ratio in lines:
        assert f"\n{name.replace('`', '')} | {rank} | {ratio.removesuffix(' |')} |" in board


def test_conda_requires_what_the_package_requires() -> None:
    run = re.findall(r"^    - (\S+) (\S+)$", CONDA.partition("\n  run:\n")[2].partition("\ntest:")[0], re.M)
    assert {name + least for name, least in run} == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def test_dockerfile_installs_extras_that_exist() -> None:
    asked = re.search(r"/src\[(.*?)\]", (ROOT / "packaging" / "Dockerfile").read_text("utf-8"))
    assert asked is not None
    assert set(asked[1].split(",")) <= set(PROJECT["optional-dependencies"])
