"""The pages on recordings are run as a reader would: manifest and adapter; columns and formats are all there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cellslam.cli.commands.export import EXPORTS
from cellslam.recordings.importing.columns import TABLES
from cellslam.recordings.importing.importing import import_folder
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import Recording
from cellslam.sim.recording.columns import COLUMNS
from tests.command_line import Run, refused

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("reference/campaign-tables.md", "reference/recording-files.md", "how-to/export.md")
PAGE = "\n".join((DOCS / name).read_text("utf-8") for name in PAGES)


def block(language: str, word: str) -> str:
    """Return the first block of code in `language` that has `word`."""
    return next(code for code in re.findall(rf"```{language}\n(.*?)```", PAGE, re.S) if word in code)


def test_the_manifest_of_the_page(tmp_path: Path) -> None:
    """A car drives east past tx1 and tx2, which stand 100 m ahead; units, signs and zeros are those of the page."""
    pytest.importorskip("pyproj", reason="extra gnss")
    t, zero = np.arange(11.0), np.zeros(11)
    delay_ns = (100.0 - 2.0 * t + 30.0) / SPEED_OF_LIGHT_MPS * 1e9
    rows = [f"{1000 * t[i]:.0f},{tx},{delay_ns[i]:.3f},90" for i in range(11) for tx in ("tx1", "tx2")]
    (tmp_path / "paths.csv").write_text("\n".join(["t,tx,delay,doa", *rows]) + "\n")
    wheels, fixes = np.column_stack([t, zero + 7.2, zero]), np.column_stack([t, zero + 55.7, 15.0 + 2.0 * t / 62_873.0])
    np.savetxt(tmp_path / "wheels.csv", wheels, "%.6f", ",", header="t,speed,gyro", comments="")
    np.savetxt(tmp_path / "gnss.csv", fixes, "%.9f", ",", header="t,lat,lon", comments="")
    (tmp_path / "recording.toml").write_text(block("toml", "courtyard"))
    r = import_folder(tmp_path)
    assert r.sites.clock_offset_std_m.tolist() == [150.0, 150.0] and len(r.measurements) == 22
    assert r.measurements.distance_m[::2] == pytest.approx(130.0 - 2.0 * t, abs=0.01)
    assert r.measurements.azimuth_rad == pytest.approx(np.zeros(22), abs=1e-9)
    assert r.odometry[1:, 0] == pytest.approx(np.full(10, 2.0)) and r.start_pose[3] == pytest.approx(0.0, abs=0.01)
    assert r.reference is not None and r.reference.position_m[-1, 0] == pytest.approx(20.0, abs=0.1)


def test_the_adapter_of_the_page(cellslam: Run) -> None:
    code = block("python", "def load")
    assert len(code.strip().splitlines()) <= 10
    Path("page_adapter.py").write_text(code)
    Path("log").mkdir()
    t = 0.5 * np.arange(40)
    np.savetxt("log/log.txt", np.column_stack([t, 40.0 - t, 0.0 * t]))
    words = ("--quiet", "import", "log", "--adapter", "page_adapter:load", "--out")
    assert cellslam(*words, "a.h5").status == 0
    r = Recording.load("a.h5")
    assert len(r.time_s) == 40 and r.odometry[1:, 0] == pytest.approx(np.ones(39)) and r.plane
    Path("log/log.txt").write_text("no numbers\n")
    refused(cellslam(*words, "b.h5"), "page_adapter")
    refused(cellslam("import", ".", "--adapter", "victoria-prak", "--out", "b.h5"), "did you mean 'victoria-park'")
    assert not Path("b.h5").exists()


def test_every_column_and_format_is_on_the_page() -> None:
    names = {name for columns in TABLES.values() for name in columns}
    assert [name for name in sorted(names) if name not in PAGE] == []
    assert [column.path for column in COLUMNS if f"`{column.path}`" not in PAGE] == []
    assert [kind for kind in EXPORTS if f"`{kind}`" not in PAGE] == []
