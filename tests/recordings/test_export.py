"""Inspection, exports and the playback page, as a user calls them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.cli import main as cli
from cellslam.recordings.exporting.maps import geojson, placement, shown
from cellslam.sim.recording import Recording
from cellslam.slam.api import VtEstimate, WallEstimate

Toy = Callable[..., Recording]
NO_VTS = VtEstimate(*np.zeros((2, 0), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


@pytest.fixture
def drive(toy_recording: Toy, tmp_path: Path) -> Path:
    path = tmp_path / "toy.h5"
    toy_recording(snapshots=60).save(path)
    return path


def test_inspect_prints_and_draws(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["inspect", str(drive)]) == 0
    text = capsys.readouterr().out
    for word in (
        "60 in 6 s, every 0.1 s",
        "links         4 of 2 sites",
        "cell_id 375",
        "suspicious    nothing",
        "truth",
    ):
        assert word in text, text
    assert drive.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["--quiet", "inspect", str(drive), "--json", "--no-figure"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["snapshots"]["count"] == 60 and found["suspicions"] == []


def test_inspect_tells_gaps_and_what_is_missing(
    toy_recording: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import dataclasses

    r = toy_recording(truth=False)
    time = 1248272270.0 + r.time_s + np.where(np.arange(40) > 20, 3.0, 0.0)
    nothing = np.full(len(r.measurements), np.nan)
    odometry = r.odometry.copy()
    odometry[:, 2] = np.nan
    r = dataclasses.replace(
        r, time_s=time, odometry=odometry, measurements=dataclasses.replace(r.measurements, snr_db=nothing)
    )
    r.save(tmp_path / "a.h5")
    assert cli.main(["--quiet", "inspect", str(tmp_path / "a.h5"), "--no-figure"]) == 0
    text = capsys.readouterr().out
    assert "gap         3.1 s at 1248272272 s" in text
    for missing in ("SNR (never measured)", "odometry u_z (never measured", "missing       truth"):
        assert missing in text


def test_inspect_refuses_a_broken_file_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.h5").write_text("no")
    assert cli.main(["inspect", str(tmp_path / "a.h5")]) == 2
    assert "not an HDF5 file" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_tum(drive: Path, tmp_path: Path) -> None:
    assert cli.main(["export", str(drive), "--format", "tum", "--out", str(tmp_path / "t.tum")]) == 0
    table = np.loadtxt(tmp_path / "t.tum")
    truth = Recording.load(drive).truth
    assert truth is not None and table.shape == (60, 8)
    assert np.allclose(table[:, 1:4], truth.poses[:, :3], atol=1e-6)
    assert np.allclose(np.linalg.norm(table[:, 4:], axis=1), 1.0)


def test_maps_of_an_estimate(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--quiet", "export", str(drive), "--estimator", "ekf-slam", "--seed", "1"]
    geojson = ["--format", "geojson", "--out", str(tmp_path / "m.geojson")]
    assert cli.main([*words, *geojson]) == 2  # GeoJSON has no metres
    assert "give --origin" in capsys.readouterr().err and not (tmp_path / "m.geojson").exists()
    assert (
        cli.main([*words, *geojson, "--origin=-33.9,151.2", "--format", "ply", "--out", str(tmp_path / "m.ply")]) == 0
    )
    features = json.loads((tmp_path / "m.geojson").read_text())["features"]
    points = [f for f in features if f["properties"]["kind"] == "vt"]
    assert features[0]["geometry"]["type"] == "LineString" and len(points) >= 1
    covariance = np.array(points[0]["properties"]["covariance_m2"])
    assert covariance.shape == (3, 3) and (np.linalg.eigvalsh(covariance) > 0).all()
    rings = [f["geometry"]["coordinates"][0] for f in features if f["properties"]["kind"] == "ellipse"]
    assert len(rings) == len(points) and all(ring[0] == ring[-1] for ring in rings)
    # A point of the ellipse is two standard deviations from its centre. Metres a degree there: WGS 84, tables.
    offset = np.array(rings[0][5])[:2] - np.array(points[0]["geometry"]["coordinates"])[:2]
    offset = offset * [92_503.0, 110_922.0]
    assert offset @ np.linalg.solve(covariance[:2, :2], offset) == pytest.approx(4.0, rel=1e-3)
    import trimesh

    cloud = trimesh.load(tmp_path / "m.ply", process=False)
    assert np.allclose(np.asarray(cloud.vertices), [p["properties"]["position_m"] for p in points], atol=1e-5)
    assert (
        cli.main(
            [
                "--quiet",
                "export",
                str(drive),
                "--format",
                "ply",
                "--estimator",
                "dead-reckoning",
                "--out",
                str(tmp_path / "n.ply"),
            ]
        )
        == 2
    )
    assert "makes no map" in capsys.readouterr().err and not (tmp_path / "n.ply").exists()


def test_one_drive_of_the_estimator_for_all_formats(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from cellslam.benchmarks.trials import trials

    driven = []
    outcome_of = trials.outcome_of

    def counted(*arguments: object) -> object:
        driven.append(arguments)
        return outcome_of(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(trials, "outcome_of", counted)
    words = ["--quiet", "export", str(drive), "--estimator", "ekf-slam", "--format", "tum", "--format", "ply"]
    assert cli.main([*words, "--out", str(tmp_path / "a.tum"), "--out", str(tmp_path / "a.ply")]) == 0
    assert len(driven) == 1 and len(np.loadtxt(tmp_path / "a.tum")) == 60
    assert (tmp_path / "a.ply").read_bytes().startswith(b"ply")
    assert cli.main([*words, "--out", str(tmp_path / "b.tum")]) == 2
    assert "2 --format and 1 --out" in capsys.readouterr().err


@pytest.mark.slow
def test_another_data_sheet_needs_no_new_import(
    drive: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The filter believes its odometry less and less; the bound keeps to what the recording says."""
    (tmp_path / "sheet.toml").write_text("[noise.u_psi]\nnoise_density = 3.0\n[noise.u_x]\nscale = 0.5\n")
    words = ["--quiet", "replay", str(drive), "--estimator", "ekf-slam", "--no-figures", "--json", "--out"]
    rows = []
    for name, more in (
        ("a", []),
        ("b", ["--options", str(tmp_path / "sheet.toml")]),
        ("c", ["--set", "noise.u_x.bias=9"]),
    ):
        assert cli.main([*words, str(tmp_path / name), *more]) == 0
        rows += json.loads(capsys.readouterr().out)
    assert len({row["position_rmse_m"] for row in rows}) == 3
    assert len({row["bound_position_rmse_m"] for row in rows}) == 1 and rows[0]["bound_position_rmse_m"] > 0
    for wrong, said in (
        ("noise.u_yaw.bias=1", "did you mean 'u_y'"),
        ("noise.u_x.bais=1", "did you mean 'noise.u_x.bias'"),
        ("noise.u_x.bias=-1", "noise.u_x.bias"),
        ("radio.load=1", "can be set"),
    ):
        assert cli.main([*words, str(tmp_path / "d"), "--set", wrong]) == 2
        assert said in capsys.readouterr().err


def test_geojson_has_the_walls(toy_recording: Toy, tmp_path: Path) -> None:
    recording = toy_recording()
    covariance = np.array([[0.01, 0.2], [0.2, 5.0]])
    walls = WallEstimate(np.array([7]), np.zeros(1), np.array([30.0]), covariance[None], np.array([[-4.0, 6.0]]))
    poses = np.tile(recording.start_pose, (40, 1))
    data = shown(recording, TrialResult("mapper", poses, np.tile(np.eye(6), (40, 1, 1)), vts=NO_VTS, walls=walls))
    geojson(data, placement(recording, (0.0, 0.0)), tmp_path / "w.geojson")
    (wall,) = (
        f for f in json.loads((tmp_path / "w.geojson").read_text())["features"] if f["properties"]["kind"] == "wall"
    )
    assert wall["properties"] == {
        "kind": "wall", "id": 7, "azimuth_rad": 0.0, "distance_m": 30.0, "covariance": covariance.tolist(),
        "ends_m": [[30.0, -4.0], [30.0, 6.0]],
    }  # fmt: skip
    # On the equator a degree is 111 320 m to the east and 110 574 m to the north.
    line = np.array(wall["geometry"]["coordinates"]) * [111_320.0, 110_574.0, 1.0]
    assert wall["geometry"]["type"] == "LineString"
    assert np.allclose(line, [[30.0, -4.0, poses[0, 2]], [30.0, 6.0, poses[0, 2]]], atol=0.01)


def test_geojson_is_placed_on_the_earth_where_the_recording_says_how(toy_recording: Toy, tmp_path: Path) -> None:
    import dataclasses

    pytest.importorskip("pyproj", reason="extra gnss")
    r = toy_recording()
    origin = [500000.0, 6094791.4]  # zone 33: 15 deg east, about 55 deg north
    r = dataclasses.replace(r, provenance={"projection": {"crs": "EPSG:32633", "origin_m": origin}})
    r.save(tmp_path / "a.h5")
    assert (
        cli.main(["export", str(tmp_path / "a.h5"), "--format", "geojson", "--out", str(tmp_path / "a.geojson")]) == 0
    )
    x, y, _ = json.loads((tmp_path / "a.geojson").read_text())["features"][0]["geometry"]["coordinates"][0]
    assert x == pytest.approx(15.0, abs=1e-3) and y == pytest.approx(55.0, abs=2e-3)


def test_playback_is_asked_for_with_an_estimator(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("plotly", reason="extra report")
    words = ["--quiet", "export", str(drive), "--format", "html", "--out", str(tmp_path / "p.html")]
    assert cli.main([*words, "--estimator", "dead-reckoning"]) == 0
    text = (tmp_path / "p.html").read_text()
    assert "Playback: dead-reckoning" in text and "<script src=" not in text  # works offline
    assert cli.main(words) == 2
    assert "--estimator" in capsys.readouterr().err


def test_exports_do_not_overwrite_folders(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("x")
    assert cli.main(["export", str(drive), "--format", "csv", "--out", str(tmp_path / "there")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["there", "toy.h5"]


def test_alignment_is_done_on_request_and_said(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "--quiet",
        "replay",
        str(drive),
        "--estimator",
        "dead-reckoning",
        "--no-figures",
        "--out",
        str(tmp_path / "o"),
    ]
    assert cli.main([*words, "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)[0]
    assert cli.main([*words, "--json", "--align"]) == 0
    aligned = json.loads(capsys.readouterr().out)[0]
    assert "alignment" not in plain and "least squares" in aligned["alignment"]
    assert aligned["position_rmse_m"] < plain["position_rmse_m"] and aligned["bound_position_rmse_m"] is None
    assert "least squares" in (tmp_path / "o" / "summary.json").read_text()
    assert cli.main([*words, "--align"]) == 0
    assert "ALIGNED" in capsys.readouterr().out
