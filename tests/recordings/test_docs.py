"""The pages on recordings are run as a reader would: manifest and adapter; columns and formats are all there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cellslam.cli.commands.export import EXPORTS
from cellslam.recordings.importing.columns import TABLES
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import Recording
from cellslam.sim.recording.columns import COLUMNS
from tests.command_line import Run, refused

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("reference/campaign-tables.md", "reference/recording-files.md", "how-to/export.md")
PAGE = "\n".join((DOCS / name).read_text("utf-8") for name in PAGES)
SOURCES = {"tx1": ((60.0, 40.0), (-30.0, 70.0)), "tx2": ((90.0, -20.0), (20.0, -60.0))}
OFFSETS_M = {"tx1": 30.0, "tx2": -45.0}


def block(language: str, word: str) -> str:
    """Return the first block of code in `language` that has `word`."""
    return next(code for code in re.findall(rf"```{language}\n(.*?)```", PAGE, re.S) if word in code)


def write_campaign(folder: Path) -> np.ndarray:
    """Write the tables that the page's manifest names, of a winding drive of 30 s; return true x, y, yaw (N, 3)."""
    rng = np.random.default_rng(4)
    dt, t = 0.02, 0.02 * np.arange(1500)
    rate = 0.2 * np.sin(t / 3.0)
    yaw = 0.4 + np.concatenate([[0.0], np.cumsum(rate[:-1] * dt)])
    steps = 2.0 * dt * np.column_stack([np.cos(yaw + 0.5 * rate * dt), np.sin(yaw + 0.5 * rate * dt)])
    place = np.vstack([[0.0, 0.0], np.cumsum(steps[:-1], axis=0)])
    paths = []
    for k in range(0, len(t), 5):
        for name, sources in SOURCES.items():
            d = np.array(sources) - place[k]
            distance = np.hypot(*d.T) + OFFSETS_M[name] + 0.2 * rng.standard_normal(2)
            azimuth = np.degrees(np.arctan2(d[:, 1], d[:, 0]) - yaw[k]) + 0.5 * rng.standard_normal(2)
            for delay, angle in zip(distance / SPEED_OF_LIGHT_MPS * 1e9, 90.0 - azimuth, strict=True):
                paths.append(f"{1000 * t[k]:.0f},{name},{delay:.3f},{(angle + 180.0) % 360.0 - 180.0:.3f}")
    folder.mkdir()
    (folder / "paths.csv").write_text("\n".join(["t,tx,delay,doa", *paths]) + "\n")
    wheels = np.column_stack([t, np.full(len(t), 7.2), -np.degrees(rate)])
    np.savetxt(folder / "wheels.csv", wheels, "%.6f", ",", header="t,speed,gyro", comments="")
    # Degrees of the ellipsoid at the central meridian of the zone, where the projection does not turn.
    fixes = np.column_stack([t, 55.7 + place[:, 1] / 111_355.0, 15.0 + place[:, 0] / 62_873.0])[::50]
    np.savetxt(folder / "gnss.csv", fixes, "%.9f", ",", header="t,lat,lon", comments="")
    return np.column_stack([place, yaw])


def test_the_manifest_of_the_page(tmp_path: Path, cellslam: Run) -> None:
    pytest.importorskip("pyproj", reason="extra gnss")
    truth = write_campaign(tmp_path / "campaign")
    (tmp_path / "campaign" / "recording.toml").write_text(block("toml", "courtyard"))
    notes = cellslam("import", "campaign", "--out", "drive.h5").err
    assert "300 snapshots, 2 links, 1200 measurements" in notes and "suspicious" not in notes
    r = Recording.load("drive.h5")
    at = truth[::5][r.measurements.snapshot]
    site = np.array(["tx1", "tx2"])[r.measurements.link]
    best = np.full(len(at), np.inf)
    for name, sources in SOURCES.items():
        for source in sources:
            d = np.array(source) - at[:, :2]
            turned = np.arctan2(d[:, 1], d[:, 0]) - at[:, 2] - r.measurements.azimuth_rad
            off = np.abs(np.hypot(*d.T) + OFFSETS_M[name] - r.measurements.distance_m) + 50.0 * np.abs(np.sin(turned))
            best = np.where(site == name, np.minimum(best, off), best)
    assert np.quantile(best, 0.99) < 3.0
    assert r.reference is not None and r.reference.position_m[-1, :2] == pytest.approx(truth[1450, :2], abs=0.5)
    assert r.start_pose[3] == pytest.approx(0.4, abs=0.03) and r.sites.clock_offset_std_m.tolist() == [150.0, 150.0]


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
