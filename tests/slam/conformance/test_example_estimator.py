"""The example package of docs/tutorials/your-estimator.md: short, installable, found by name, conformant."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "my-estimator"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """Install the package beside this environment, and return a folder and the variables that make it found."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(EXAMPLE, folder / "source", ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet")
    wanted = ("--no-deps", "--no-build-isolation", "--target", folder / "site", folder / "source")
    subprocess.run([*pip, *map(str, wanted)], check=True, capture_output=True, cwd=folder)
    return folder, {**os.environ, "PYTHONPATH": str(folder / "site")}


def run(installed: tuple[Path, dict[str, str]], *words: str) -> str:
    folder, variables = installed
    command = [sys.executable, "-m", *words]
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_is_listed_run_and_better_than_dead_reckoning(installed: tuple[Path, dict[str, str]]) -> None:
    assert "from the package my-estimator" in " ".join(run(installed, "cellslam", "list", "estimators").split())
    request = ("tiny", "--seed", "1", "--trials", "3", "--json", "--no-figures", "--quiet")
    names = ("--estimator", "zero-velocity", "--estimator", "dead-reckoning")
    option = ("--set", "estimator.zero-velocity.standing_mps=0.05")
    rows = json.loads(run(installed, "cellslam", "run", *request, *names, *option))
    heading = {name: sum(r["heading_rmse_rad"] for r in rows if r["estimator"] == name) for name in names[1::2]}
    assert heading["zero-velocity"] < heading["dead-reckoning"]


@pytest.mark.slow
def test_passes_its_own_tests(installed: tuple[Path, dict[str, str]]) -> None:
    assert "14 passed" in run(installed, "pytest", "-q", "-p", "no:cacheprovider", "source/test_my_estimator.py")
