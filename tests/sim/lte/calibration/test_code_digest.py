"""The digest of the code that statistics.json was measured with: what acts is in it, what does not is not."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from cellslam.sim.lte.calibration.code_digest import CODE, RUNNING, SIM, code_digest, outdated
from cellslam.sim.lte.statistical.statistics import file_of

KERNEL = "lte/signal/path_estimator/search_kernel.py"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copytree(SIM, tmp_path / "sim", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "sim"


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text("utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), "utf-8")


def test_a_copy_has_the_same_digest(copy: Path) -> None:
    assert code_digest(copy) == code_digest()
    assert all((copy / part).exists() for part in CODE)
    assert all((copy / "lte/signal" / name).exists() for name in RUNNING)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        (KERNEL, "best, at, bin_at, level_at = np.float32(0.0),", "best, at, bin_at, level_at = np.float32(1.0),"),
        (KERNEL, "LOCAL_EXCESS, AROUND_EXCESS = 1.7, 1.15", "LOCAL_EXCESS, AROUND_EXCESS = 1.7, 1.16"),
        ("lte/array.py", "columns: int = 16", "columns: int = 12"),
        ("rays/antenna.py", "(azimuth / azimuth_width_rad) ** 2", "(azimuth / azimuth_width_rad) ** 4"),
    ],
)
def test_what_acts_changes_it(copy: Path, file: str, old: str, new: str) -> None:
    edit(copy / file, old, new)
    assert code_digest(copy) != code_digest()
    assert code_digest(copy) in outdated(copy)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# A path's own sidelobes", "# Its own sidelobes"),
        ('"""Write the median over', '"""Write a median over'),
        ("import numpy as np", "import math\nimport os\n\nimport numpy as np"),
        (
            "def running_median(values: Array, width: int, out: Array) -> None:",
            "def running_median(values, width, out):",
        ),
        (
            "    best, at, bin_at, level_at = np.float32(0.0), -1, -1, 0.0\n",
            "    best, at, bin_at, level_at = (np.float32(0.0), -1, -1,\n  0.0)\n",
        ),
        ('"""Compiled search', 'if TYPE_CHECKING:\n    import os\n"""Compiled search'),
    ],
)
def test_what_does_not_act_leaves_it(copy: Path, old: str, new: str) -> None:
    edit(copy / KERNEL, old, new)
    assert code_digest(copy) == code_digest()


def test_constants_of_other_code_are_called_out_of_date(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = json.loads(file_of().read_text("utf-8"))
    data["provenance"]["code"] = code_digest()
    (copy / "nr-48.json").write_text(json.dumps(data), "utf-8")
    monkeypatch.setattr("cellslam.sim.lte.calibration.code_digest.file_of", lambda band: copy / f"{band}.json")
    assert outdated(band="nr-48") == ""
    edit(copy / KERNEL, "SIDELOBES = 0.01", "SIDELOBES = 0.02")
    assert "nr-48.json was measured with other code" in outdated(copy, "nr-48")
