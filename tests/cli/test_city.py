"""`cellslam city` end to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.cli.cities import find_city
from cellslam.sim.rays import trace
from tests.command_line import Run, refused

SITE = "--bs=17.3,-45.3,32.4"


@pytest.fixture
def receivers(tmp_path: Path) -> Path:
    x = np.linspace(-140.0, 100.0, 60)
    table = pd.DataFrame({"x": x, "y": 140.0 + 0.0 * x, "z": 1.8, "vx": 5.0, "vy": 0.0, "vz": 0.0})
    table.to_csv(tmp_path / "rx.csv", index=False)
    return tmp_path / "rx.csv"


@pytest.mark.slow
def test_trace_writes_what_trace_returns(receivers: Path, cellslam: Run) -> None:
    words = ("city", "trace", "tiny", "--bs", "-97.8,150.7,34.1", SITE, "--rx", receivers, "--out", "paths.csv")
    pictures = ("--plan", "p.png", "--view", "v.png", "--html", "r.html")
    done = cellslam(*words, "--max-order", "2", "--diffraction", *pictures)
    assert done.status == 0 and "diffracted" in done.err
    table = pd.read_csv("paths.csv")
    places = pd.read_csv(receivers)[["x", "y", "z"]].to_numpy()
    sites = [[-97.8, 150.7, 34.1], [17.3, -45.3, 32.4]]
    paths = trace(find_city("tiny"), sites, places, 2, diffraction=True)
    assert len(table) == len(paths) > 100
    np.testing.assert_allclose(table.length_m, paths.length_m, atol=1e-8)
    np.testing.assert_allclose(table[["vt_x", "vt_y", "vt_z"]], paths.vt_position_m, atol=1e-8)
    np.testing.assert_allclose(table[["x1", "y1", "z1", "x2", "y2", "z2"]], paths.points_m.reshape(-1, 6), atol=1e-8)
    np.testing.assert_allclose(table.doppler_hz, paths.doppler_hz([5.0, 0.0, 0.0], 2.66e9), atol=1e-5)
    np.testing.assert_array_equal(table[["receiver", "transmitter"]].T, [paths.receiver, paths.transmitter])
    for picture in ("p.png", "v.png", "r.html"):
        assert Path(picture).stat().st_size > 10_000
    assert "<script src=" not in Path("r.html").read_text()  # works offline


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["tiny", "--bs=1,2"], "write X,Y,Z"),
        (["tiny", "--bs=0,0,-3"], "under the ground"),
        (["sionna-rt:munick", "--bs=0,0,3"], "did you mean 'munich'"),
        (["tiny", SITE, "--carrier", "3"], "carrier_hz 3"),
        (["tiny", SITE, "--material", "brick"], "is a scenario"),
    ],
)
def test_wrong_requests(receivers: Path, cellslam: Run, words: list[str], text: str) -> None:
    refused(cellslam("city", "trace", *words, "--rx", receivers, "--out", "paths.csv"), text)


@pytest.mark.parametrize(
    ("content", "text"),
    [("a,b\n1,2\n", "no column x, y, z"), ("x,y,z\n", "no rows"), ("x,y,z\n1,2,nan\n", "row 0")],
)
def test_wrong_receivers(cellslam: Run, content: str, text: str) -> None:
    Path("rx.csv").write_text(content)
    refused(cellslam("city", "trace", "tiny", SITE, "--rx", "rx.csv", "--out", "paths.csv"), text)


@pytest.mark.slow
def test_generate_then_inspect(cellslam: Run) -> None:
    keys = ("--set", "extent_m=180", "--set", "block_size_m=80", "--set", "shop_share=0.5")
    assert cellslam("city", "generate", "--seed", "7", *keys, "--out", "made").status == 0
    assert Path("made/plan.png").exists()
    mesh, drawn = (
        json.loads(cellslam("city", "inspect", f"made/{name}", "--no-figures", "--json").out)
        for name in ("city.xml", "city-7.toml")
    )
    for key in ("buildings", "triangles", "facets", "low_m", "high_m"):
        assert mesh[key] == drawn[key]
    short = ("--set", "vehicle.distance_m=10", "--set", "vehicle.stops=0", "--set", "vehicle.duration_s=20")
    words = ("run", "made/city-7.toml", *short, "--estimator", "dead-reckoning", "--rays", "--out", "ran")
    assert cellslam(*words).status == 0
    assert {"rays.png", "rays-view.png", "rays.html"} < {path.name for path in Path("ran").iterdir()}


@pytest.mark.slow
def test_a_hundred_thousand_receivers_in_munich_need_less_than_a_gigabyte() -> None:
    # A parent that has been larger than the limit says nothing about its child.
    np.ones(150_000_000)
    words = ["rays", "--no-peers", "--receivers", "100000", "--transmitters", "1", "--repeat", "1", "--json", "--quiet"]
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-m", "tools", *words], cwd=root, capture_output=True, text=True, check=True)
    row = json.loads(done.stdout)["sizes"][0]
    assert row["receivers"] == 100_000 and row["paths"] > 50_000 and row["peak_bytes"] < 1e9


def test_a_transmitter_in_a_building_is_refused(receivers: Path, cellslam: Run) -> None:
    x, y = find_city("tiny").footprints[0].representative_point().coords[0]
    words = ("city", "trace", "tiny", f"--bs={x},{y},5", "--rx", receivers, "--out", "p.csv")
    refused(cellslam(*words), "inside building 0, whose roof is at")
