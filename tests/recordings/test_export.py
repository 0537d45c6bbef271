"""Inspection, exports and the playback page, as a user calls them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.recordings.exporting.maps import geojson, placement, shown
from cellslam.sim.recording import Recording
from cellslam.slam.api import VtEstimate, WallEstimate
from tests.command_line import Run, refused

Toy = Callable[..., Recording]
NO_VTS = VtEstimate(*np.zeros((2, 0), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


@pytest.fixture
def drive(toy_recording: Toy, tmp_path: Path) -> Path:
    toy_recording(snapshots=60).save(tmp_path / "toy.h5")
    return tmp_path / "toy.h5"


def features(file: Path, kind: str) -> list[dict[str, dict]]:
    return [f for f in json.loads(file.read_text())["features"] if f["properties"]["kind"] == kind]


def test_inspect_prints_and_draws(drive: Path, cellslam: Run) -> None:
    text = cellslam("inspect", drive).out
    for word in ("60 in 6 s, every 0.1 s", "4 of 2 sites", "suspicious    nothing"):
        assert word in text, text
    assert drive.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    found = json.loads(cellslam("--quiet", "inspect", drive, "--json", "--no-figure").out)
    assert found["snapshots"]["count"] == 60 and found["suspicions"] == []


def test_inspect_tells_gaps_and_what_is_missing(toy_recording: Toy, tmp_path: Path, cellslam: Run) -> None:
    r = toy_recording(truth=False)
    odometry = r.odometry.copy()
    odometry[:, 2] = np.nan
    dataclasses.replace(
        r,
        time_s=1248272270.0 + r.time_s + np.where(np.arange(40) > 20, 3.0, 0.0),
        odometry=odometry,
        measurements=dataclasses.replace(r.measurements, snr_db=np.full(len(r.measurements), np.nan)),
    ).save(tmp_path / "a.h5")
    text = cellslam("--quiet", "inspect", "a.h5", "--no-figure").out
    assert "gap         3.1 s at 1248272272 s" in text
    for missing in ("SNR (never measured)", "odometry u_z (never measured", "missing       truth"):
        assert missing in text


def test_tum(drive: Path, cellslam: Run) -> None:
    assert cellslam("export", drive, "--format", "tum", "--out", "t.tum").status == 0
    table, truth = np.loadtxt("t.tum"), Recording.load(drive).truth
    assert truth is not None and table.shape == (60, 8)
    assert np.allclose(table[:, 1:4], truth.poses[:, :3], atol=1e-6)
    assert np.allclose(np.linalg.norm(table[:, 4:], axis=1), 1.0)


def test_maps_of_an_estimate(drive: Path, cellslam: Run) -> None:
    words = ("--quiet", "export", drive, "--estimator", "ekf-slam", "--seed", 1)
    places = ("--format", "geojson", "--out", "m.geojson")
    refused(cellslam(*words, *places), "give --origin")  # GeoJSON has no metres
    refused(cellslam(*words, *places, "--format", "ply"), "2 --format and 1 --out")
    assert not Path("m.geojson").exists()
    assert cellslam(*words, *places, "--origin=-33.9,151.2", "--format", "ply", "--out", "m.ply").status == 0
    points, ellipses = (features(Path("m.geojson"), kind) for kind in ("vt", "ellipse"))
    covariance = np.array(points[0]["properties"]["covariance_m2"])
    rings = [f["geometry"]["coordinates"][0] for f in ellipses]
    assert len(rings) == len(points) >= 1
    # A point of the ellipse is two standard deviations from its centre. Metres a degree there: WGS 84, tables.
    offset = np.array(rings[0][5])[:2] - np.array(points[0]["geometry"]["coordinates"])[:2]
    offset = offset * [92_503.0, 110_922.0]
    assert offset @ np.linalg.solve(covariance[:2, :2], offset) == pytest.approx(4.0, rel=1e-3)
    cloud = trimesh.load("m.ply", process=False)
    assert np.allclose(np.asarray(cloud.vertices), [p["properties"]["position_m"] for p in points], atol=1e-5)


@pytest.mark.slow
def test_another_data_sheet_needs_no_new_import(drive: Path, cellslam: Run) -> None:
    """The filter believes its odometry less and less; the bound keeps to what the recording says."""
    Path("sheet.toml").write_text("[noise.u_psi]\nnoise_density = 3.0\n[noise.u_x]\nscale = 0.5\n")
    words = ("--quiet", "replay", drive, "--estimator", "ekf-slam", "--no-figures", "--json")
    sheets = ((), ("--options", "sheet.toml"), ("--set", "noise.u_x.bias=9"))
    rows = [cellslam(*words, *more).rows[0] for more in sheets]
    assert len({row["position_rmse_m"] for row in rows}) == 3
    assert len({row["bound_position_rmse_m"] for row in rows}) == 1 and rows[0]["bound_position_rmse_m"] > 0
    refused(cellslam(*words, "--set", "noise.u_x.bais=1"), "did you mean 'noise.u_x.bias'")


def test_geojson_has_the_walls(toy_recording: Toy, tmp_path: Path) -> None:
    recording = toy_recording()
    walls = WallEstimate(np.array([7]), np.zeros(1), np.array([30.0]), np.eye(2)[None], np.array([[-4.0, 6.0]]))
    poses = np.tile(recording.start_pose, (40, 1))
    data = shown(recording, TrialResult("mapper", poses, np.tile(np.eye(6), (40, 1, 1)), vts=NO_VTS, walls=walls))
    geojson(data, placement(recording, (0.0, 0.0)), tmp_path / "w.geojson")
    (wall,) = features(tmp_path / "w.geojson", "wall")
    # On the equator a degree is 111 320 m to the east and 110 574 m to the north.
    line = np.array(wall["geometry"]["coordinates"])[:, :2] * [111_320.0, 110_574.0]
    assert np.allclose(line, [[30.0, -4.0], [30.0, 6.0]], atol=0.01)


def test_geojson_is_placed_on_the_earth_where_the_recording_says_how(toy_recording: Toy, cellslam: Run) -> None:
    pytest.importorskip("pyproj", reason="extra gnss")
    origin = [500000.0, 6094791.4]  # zone 33: 15 deg east, about 55 deg north
    projection = {"projection": {"crs": "EPSG:32633", "origin_m": origin}}
    dataclasses.replace(toy_recording(), provenance=projection).save("a.h5")
    assert cellslam("export", "a.h5", "--format", "geojson", "--out", "a.geojson").status == 0
    x, y, _ = features(Path("a.geojson"), "trajectory")[0]["geometry"]["coordinates"][0]
    assert x == pytest.approx(15.0, abs=1e-3) and y == pytest.approx(55.0, abs=2e-3)


def test_playback_is_asked_for_with_an_estimator(drive: Path, cellslam: Run) -> None:
    pytest.importorskip("plotly", reason="extra report")
    words = ("--quiet", "export", drive, "--format", "html", "--out", "p.html")
    assert cellslam(*words, "--estimator", "dead-reckoning").status == 0
    text = Path("p.html").read_text()
    assert "Playback: dead-reckoning" in text and "<script src=" not in text  # works offline
    refused(cellslam(*words), "--estimator")


def test_exports_do_not_overwrite_folders(drive: Path, tmp_path: Path, cellslam: Run) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("x")
    refused(cellslam("export", drive, "--format", "csv", "--out", "there"), "exists already")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["there", "toy.h5"]


def test_alignment_is_done_on_request_and_told(drive: Path, cellslam: Run) -> None:
    words = ("--quiet", "replay", drive, "--estimator", "dead-reckoning", "--no-figures", "--out", "o")
    (plain,), (aligned,) = cellslam(*words, "--json").rows, cellslam(*words, "--json", "--align").rows
    assert "alignment" not in plain and "least squares" in aligned["alignment"]
    assert aligned["position_rmse_m"] < plain["position_rmse_m"] and aligned["bound_position_rmse_m"] is None
    assert "least squares" in Path("o/summary.json").read_text()
    assert "ALIGNED" in cellslam(*words, "--align").out
