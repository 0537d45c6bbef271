"""`cellslam city` and `cellslam bench` end to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.cli.cities import find_city
from cellslam.cli.main import main
from cellslam.sim.rays import trace


@pytest.fixture
def receivers(tmp_path):
    x = np.linspace(-140.0, 100.0, 60)
    table = pd.DataFrame({"x": x, "y": 140.0 + 0.0 * x, "z": 1.8, "vx": 5.0, "vy": 0.0, "vz": 0.0})
    table.to_csv(tmp_path / "rx.csv", index=False)
    return tmp_path / "rx.csv"


@pytest.mark.slow
def test_trace_writes_what_trace_returns(tmp_path, receivers, capsys):
    out = tmp_path / "paths.csv"
    words = ["city", "trace", "tiny", "--bs", "-97.8,150.7,34.1", "--bs=17.3,-45.3,32.4", "--rx", str(receivers)]
    pictures = [
        "--plan",
        str(tmp_path / "p.png"),
        "--view",
        str(tmp_path / "v.png"),
        "--html",
        str(tmp_path / "r.html"),
    ]
    assert main([*words, "--out", str(out), "--max-order", "2", "--diffraction", *pictures]) == 0
    table = pd.read_csv(out)
    assert list(table.columns[:9]) == [
        "receiver", "order", "length_m", "azimuth_rad", "elevation_rad", "gain_db", "vt_x", "vt_y", "vt_z",
    ]  # fmt: skip
    places = pd.read_csv(receivers)[["x", "y", "z"]].to_numpy()
    sites = [[-97.8, 150.7, 34.1], [17.3, -45.3, 32.4]]
    paths = trace(find_city("tiny"), sites, places, 2, diffraction=True)
    assert len(table) == len(paths) > 100
    np.testing.assert_allclose(table.length_m, paths.length_m, atol=1e-8)
    np.testing.assert_allclose(table[["vt_x", "vt_y", "vt_z"]], paths.vt_position_m, atol=1e-8)
    np.testing.assert_allclose(table[["x1", "y1", "z1", "x2", "y2", "z2"]], paths.points_m.reshape(-1, 6), atol=1e-8)
    np.testing.assert_allclose(table.doppler_hz, paths.doppler_hz([5.0, 0.0, 0.0], 2.66e9), atol=1e-5)
    assert set(table.order) == {0, 1, 2}
    assert "diffracted" in capsys.readouterr().err
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert (tmp_path / "v.png").stat().st_size > 10_000
    page = (tmp_path / "r.html").read_text()
    assert "<script src=" not in page
    assert len(page) > 1_000_000


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["tiny", "--bs=1,2"], "write X,Y,Z"),
        (["tiny", "--bs=0,0,-3"], "under the ground"),
        (["sionna-rt:munick", "--bs=0,0,3"], "did you mean 'munich'"),
        (["none.ply", "--bs=0,0,3"], "No such file"),
        (["tiny", "--bs=17.3,-45.3,32.4", "--max-order", "3"], "max_order 3"),
        (["tiny", "--bs=17.3,-45.3,32.4", "--carrier", "3"], "carrier_hz 3"),
        (["tiny", "--bs=17.3,-45.3,32.4", "--material", "brick"], "is a scenario"),
    ],
)
def test_wrong_requests(tmp_path, receivers, capsys, words, says):
    assert main(["city", "trace", *words, "--rx", str(receivers), "--out", str(tmp_path / "paths.csv")]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_a_transmitter_in_a_building_is_refused(tmp_path, receivers, capsys):
    x, y = find_city("tiny").footprints[0].representative_point().coords[0]
    words = ["city", "trace", "tiny", f"--bs={x},{y},5", "--rx", str(receivers), "--out", str(tmp_path / "p.csv")]
    assert main(words) == 2
    assert "inside building 0, whose roof is at" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "says"),
    [("a,b\n1,2\n", "no column x, y, z"), ("x,y,z\n", "no rows"), ("x,y,z\n1,2,nan\n", "row 0"), ("", "cannot read")],
)
def test_wrong_receivers(tmp_path, capsys, content, says):
    (tmp_path / "rx.csv").write_text(content)
    words = ["city", "trace", "tiny", "--bs=17.3,-45.3,32.4", "--rx", str(tmp_path / "rx.csv")]
    assert main([*words, "--out", str(tmp_path / "paths.csv")]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_generate_then_inspect(tmp_path, capsys):
    out = tmp_path / "made"
    keys = ["--set", "extent_m=180", "--set", "block_size_m=80", "--set", "shop_share=0.5"]
    assert main(["city", "generate", "--seed", "7", *keys, "--out", str(out)]) == 0
    assert (out / "plan.png").exists()
    capsys.readouterr()
    described = []
    for name in (out / "city.xml", out / "city-7.toml"):
        assert main(["city", "inspect", str(name), "--no-figures", "--json"]) == 0
        described.append(json.loads(capsys.readouterr().out))
    for key in ("buildings", "triangles", "facets", "low_m", "high_m"):
        assert described[0][key] == described[1][key]
    assert set(described[0]["area_m2"]) == set(described[1]["area_m2"])
    city = find_city(str(out / "city-7.toml"))
    names = {city.materials[m].name for m in city.facets.material}
    assert {"glass", "metal"} < names
    capsys.readouterr()
    assert main(["run", str(out / "city-7.toml"), "--set", "vehicle.distance_m=10", "--set", "vehicle.stops=0",
                 "--set", "vehicle.duration_s=20",
                 "--estimator", "dead-reckoning", "--rays", "--out", str(tmp_path / "ran")]) == 0  # fmt: skip
    assert {"rays.png", "rays-view.png", "rays.html"} < {path.name for path in (tmp_path / "ran").iterdir()}


@pytest.mark.slow
def test_a_hundred_thousand_receivers_in_munich_need_less_than_a_gigabyte():
    # A parent that has been larger than the limit says nothing about its child.
    np.ones(150_000_000)
    words = ["rays", "--no-peers", "--receivers", "100000", "--transmitters", "1", "--repeat", "1", "--json", "--quiet"]
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-m", "tools", *words], cwd=root, capture_output=True, text=True, check=True)
    row = json.loads(done.stdout)["sizes"][0]
    assert row["receivers"] == 100_000
    assert row["paths"] > 50_000
    assert row["peak_bytes"] < 1e9
