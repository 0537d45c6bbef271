"""The pages on recordings are run as a reader would: manifest and adapter; columns and formats are all there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.cli.commands.export import EXPORTS
from cellslam.recordings.importing.campaign import build
from cellslam.recordings.importing.importing import TABLES, import_folder
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


KIND = (DOCS / "how-to" / "your-own-kind-of-data.md").read_text("utf-8")
CHANGES = re.findall(r"^\| (.*?) \| `(.*?)` \| (?:`(.*?)`)? ?\|$", KIND, re.M)


@pytest.mark.parametrize(("data", "line", "becomes"), [("the page's own", "", ""), *CHANGES])
def test_any_kind_of_data(data: str, line: str, becomes: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The adapter of the page, and what becomes of it with other data, imports a drive along two masts."""
    code = re.findall(r"```python\n(.*?)```", KIND, re.S)[0]
    assert len(code[code.index("def load") :].strip().splitlines()) <= 20
    one = data.startswith(("nothing tells", "one clock"))
    if one:  # one site has one place
        code = code.replace(CHANGES[0][1], CHANGES[0][2])
    assert code.count(line) >= 1
    t, place = np.repeat(0.5 * np.arange(40), 2), np.tile([[30.0, 8.0], [40.0, -9.0]], (40, 1))
    away = place - np.column_stack([t, 0.0 * t])
    delay_ns = np.hypot(*away.T) / SPEED_OF_LIGHT_MPS * 1e9
    azimuth_deg = np.degrees(np.arctan2(away[:, 1], away[:, 0]))
    tables = {
        "paths": [t, np.tile([4, 9], 40), delay_ns, azimuth_deg], "wheels": [t[::2], 1.0 + 0.0 * t[::2], 0.0 * t[::2]],
        "masts": [[4, 9], *place[:2].T, [0.0, 0.0]], "fixes": [t[::4], t[::4], 0.0 * t[::4]],
    }  # fmt: skip
    for name, columns in tables.items():
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack(columns))
    names: dict[str, Any] = {}
    exec(code.replace(line, becomes) if line else code, names)
    r = build(names["load"](tmp_path))
    assert len(r.measurements) == 80 and r.odometry[1:, 0] == pytest.approx(np.ones(39))
    assert len(r.sites) == (1 if one else 2)
    assert len(r.links) == (1 if data.startswith("nothing tells") else 2)
    known = not one and not data.startswith("nobody")
    assert (r.sites.position_m is not None) == known
    assert np.isnan(r.measurements.azimuth_rad).all() == (data == "no angles")
    assert np.isnan(r.measurements.distance_m).all() == (data == "no distances")
    assert np.all(r.sites.clock_offset_std_m == (0.0 if "clock" in data and "one clock" not in data else 30.0))
    assert (r.reference is None) == (data == "no reference") and r.plane == ("one plane" in data)
