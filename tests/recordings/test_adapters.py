"""Adapters for public data, on small files of the same layout; estimators on a drive among trees."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.tampere import NAME
from cellslam.recordings.adapters.tree_trunks import find_trees
from cellslam.recordings.adapters.victoria_park import velocities
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Measurements, Recording
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS

FITTED = {
    "noise_floor_m": 0.1,
    "noise_floor_azimuth_deg": 0.3,
    "noise_unit_snr_m": 0.0,
    "noise_unit_snr_azimuth_deg": 0.0,
    **NOTHING_PERSISTS,
    "clutter_density": 0.01,
}


def circle_scan(x: float, y: float, radius: float) -> np.ndarray:
    """Return the 361 ranges to one round trunk, worked out beam by beam."""
    out = np.full(361, 81.91)
    for i in range(361):
        a = np.pi * i / 360 - np.pi / 2
        along, across = x * np.cos(a) + y * np.sin(a), abs(-x * np.sin(a) + y * np.cos(a))
        if along > 0 and across < radius:
            out[i] = along - np.sqrt(radius**2 - across**2)
    return out


@pytest.mark.parametrize(("x", "y", "radius"), [(10.0, 0.0, 0.3), (6.0, 8.0, 0.2), (5.0, -4.0, 0.4), (20.0, 3.0, 0.35)])
def test_a_trunk_is_found_at_its_centre(x: float, y: float, radius: float) -> None:
    found = find_trees(circle_scan(x, y, radius)[None])
    assert len(found.scan) == 1
    assert found.range_m[0] == pytest.approx(np.hypot(x, y), abs=0.1)
    assert found.bearing_rad[0] == pytest.approx(np.arctan2(y, x), abs=0.006)
    assert found.diameter_m[0] == pytest.approx(2 * radius, abs=2.2 * np.hypot(x, y) * np.pi / 360)


def test_what_is_no_trunk_is_left_out() -> None:
    wall = np.full(361, 81.91)
    wall[100:200] = 12.0
    assert len(find_trees(wall[None]).scan) == 0
    hidden = np.minimum(circle_scan(20.0, 0.0, 0.4), circle_scan(19.0 * 0.5, -0.15, 0.2))
    assert np.all(find_trees(hidden[None]).range_m < 12.0)  # the one behind shows one edge only
    assert len(find_trees(np.full((3, 361), 81.91)).scan) == 0


def test_the_vehicle_model_by_hand() -> None:
    """Straight on the wheel's speed is the vehicle's; in a curve to the left the left wheel is slower and the nose
    moves left.
    """
    straight = velocities(np.array([2.0]), np.array([0.0]))
    assert [straight[n][0] for n in ("u_x", "u_y", "u_psi")] == [2.0, 0.0, 0.0]
    left = velocities(np.array([2.0]), np.array([0.2]))
    v = 2.0 / (1 - np.tan(0.2) * 0.76 / 2.83)
    omega = v * np.tan(0.2) / 2.83
    assert left["u_psi"][0] == pytest.approx(omega)
    assert left["u_x"][0] == pytest.approx(v - 0.5 * omega) and left["u_y"][0] == pytest.approx(3.78 * omega)


@pytest.fixture(scope="module")
def park(vehicle_files: Path) -> Recording:
    return import_adapter(vehicle_files, "victoria-park")


def truth_at(park: Recording, drive: object) -> np.ndarray:
    """Return true x, y, yaw at the snapshots; the files' clock starts at 5 s."""
    times, poses = drive.time_s, drive.poses  # type: ignore[attr-defined]
    at = park.time_s - 5.0
    return np.column_stack([np.interp(at, times, c) for c in (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))])


def test_trees_of_the_vehicle_data_are_where_they_stand(park: Recording, vehicle_drive: object) -> None:
    m, truth = park.measurements, truth_at(park, vehicle_drive)[park.measurements.snapshot]
    seen = truth[:, :2] + m.distance_m[:, None] * np.column_stack(
        [np.cos(truth[:, 2] + m.azimuth_rad), np.sin(truth[:, 2] + m.azimuth_rad)]
    )
    trees = vehicle_drive.trees[:, :2]  # type: ignore[attr-defined]
    error = (
        np.sqrt(((seen[:, None] - trees[None]) ** 2).sum(axis=2).min(axis=1))
        if len(seen) < 4000
        else nearest(seen, trees)
    )
    assert np.quantile(error, 0.99) < 0.25 and 7.0 < len(m) / len(park.time_s) < 11.0
    assert park.plane and np.isnan(m.elevation_rad).all() and np.isnan(m.snr_db).all()
    assert np.isnan(park.odometry[:, [2, 4, 5]]).all() and park.reference is not None
    assert park.start_pose[:2] == pytest.approx(truth_at(park, vehicle_drive)[0, :2], abs=0.8)
    assert park.start_pose[3] == pytest.approx(truth_at(park, vehicle_drive)[0, 2], abs=0.06)


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(others).query(points)[0])


def rmse(recording: Recording, name: str, **options: object) -> tuple[float, float]:
    request = resolve({name: options} if options else {}, [name], ())[0]
    warm_up(request)
    result = estimate(recording, request, np.random.default_rng(5))
    scores = score(recording, result, None)
    seconds = recording.time_s[-1] - recording.time_s[0]
    return float(scores["position_rmse_m"] or np.nan), float(seconds / result.estimate_seconds)


@pytest.mark.slow
def test_filters_beat_dead_reckoning_tenfold_among_500_trees(park: Recording) -> None:
    """CELLSLAM_VEHICLE_S=3600 makes it the drive of an hour."""
    reckoned, _ = rmse(park, "dead-reckoning")
    slam, speed = rmse(park, "fastslam", particles=100, **FITTED)
    assert slam < reckoned / 10.0, (slam, reckoned)
    assert speed > 10.0, speed


@pytest.mark.slow
def test_ekf_slam_among_500_trees(park: Recording) -> None:
    reckoned, _ = rmse(park, "dead-reckoning")
    slam, _ = rmse(park, "ekf-slam", vts=600, **FITTED)
    assert slam < reckoned / 8.0, (slam, reckoned)


def test_vehicle_files_that_lack_something(vehicle_world: ModuleType, tmp_path: Path) -> None:
    vehicle_world.write(tmp_path, vehicle_world.drive(30.0, 60, 4, size_m=80.0), 5)
    variables = {k: v for k, v in loadmat(tmp_path / "aa3_dr.mat").items() if k[0] != "_"}
    steering = variables.pop("steering")
    savemat(tmp_path / "aa3_dr.mat", variables | {"stering": steering})
    with pytest.raises(InputError, match=r"aa3_dr\.mat: no variable 'steering'; did you mean 'stering'"):
        import_adapter(tmp_path, "victoria-park")
    (tmp_path / "aa3_gpsx.mat").unlink()
    savemat(tmp_path / "aa3_dr.mat", variables | {"steering": steering})
    with pytest.raises(InputError, match=r"aa3_gpsx\.mat: no such file"):
        import_adapter(tmp_path, "victoria-park")


def indoor(tmp_path: Path) -> Path:
    """Write a file in the layout of the 60 GHz campaign: 45 places in a hall, a transmitter, three walls."""
    rng = np.random.default_rng(7)
    angle = np.linspace(0, 1.5 * np.pi, 45)
    rx = np.stack([6 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2])
    sources = np.array(
        [[9.0, 1.0], [-9.0 - 16.0, 1.0], [9.0, 13.0], [9.0, -15.0]]
    )  # the transmitter and its mirror images
    y = np.empty((1, 45), object)
    power = np.empty((1, 45), object)
    for k in range(45):
        d = sources - rx[:2, k]
        arrival = np.arctan2(d[:, 1], d[:, 0]) - rx[2, k] + np.radians(1.0) * rng.standard_normal(4)
        y[0, k] = np.stack([np.hypot(*d.T) + 0.1 * rng.standard_normal(4), rng.uniform(-3, 3, 4), arrival + 4 * np.pi])
        power[0, k] = rng.uniform(-90, -50, (1, 4))
    savemat(tmp_path / NAME, {"sim": {"rx": rx, "tx": np.tile([[9.0], [1.0], [0.0]], 45), "y": y, "power": power}})
    return tmp_path


def test_the_60_ghz_campaign(tmp_path: Path) -> None:
    r = import_adapter(indoor(tmp_path), "tampere-60ghz")
    assert len(r.time_s) == 45 and len(r.measurements) == 180 and r.plane
    assert r.reference is not None and np.isfinite(r.reference.yaw_rad).all()
    pose, m = np.column_stack([r.reference.position_m[:, :2], r.reference.yaw_rad]), r.measurements
    towards = pose[m.snapshot, 2] + m.azimuth_rad
    ends = pose[m.snapshot, :2] + m.distance_m[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    sources = np.array([[9.0, 1.0], [-25.0, 1.0], [9.0, 13.0], [9.0, -15.0]])
    assert np.quantile(nearest(ends, sources), 0.95) < 1.2
    assert "simulated" in r.provenance["description"]
    alone, _ = rmse(r, "dead-reckoning")
    slam, _ = rmse(r, "fastslam", particles=100, noise_model="claimed")
    assert slam < alone


def test_a_60_ghz_file_that_lacks_something(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no Kampusareena"):
        import_adapter(tmp_path, "tampere-60ghz")
    savemat(tmp_path / NAME, {"sim": {"rx": np.zeros((3, 2))}})
    with pytest.raises(InputError, match="'sim' has no field 'tx'"):
        import_adapter(tmp_path, "tampere-60ghz")


def test_cut_recordings_stay_sound(park: Recording) -> None:
    keep = park.measurements.snapshot < 50
    columns = [getattr(park.measurements, f.name) for f in dataclasses.fields(park.measurements)]
    cut = dataclasses.replace(
        park,
        time_s=park.time_s[:50],
        odometry=park.odometry[:50],
        measurements=Measurements(*(None if c is None else c[keep] for c in columns)),
    )
    assert np.isfinite(rmse(cut, "dead-reckoning")[0])
