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


def test_conda_requires_what_the_package_requires() -> None:
    run = re.findall(r"^    - (\S+) (\S+)$", CONDA.partition("\n  run:\n")[2].partition("\ntest:")[0], re.M)
    assert {name + least for name, least in run} == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def test_dockerfile_installs_extras_that_exist() -> None:
    asked = re.search(r"/src\[(.*?)\]", (ROOT / "packaging" / "Dockerfile").read_text("utf-8"))
    assert asked is not None
    assert set(asked[1].split(",")) <= set(PROJECT["optional-dependencies"])
