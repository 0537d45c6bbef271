"""Adapters for public data, on small files of the same layout; estimators on a drive among trees."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat
from scipy.spatial import cKDTree

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.tampere import NAME
from cellslam.recordings.adapters.victoria_park import find_trees, velocities
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from tests.recordings import vehicle_world

Rmse = Callable[..., float]
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
def park(vehicle_drive: Any, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The recording of the three .mat files of a drive."""
    folder = tmp_path_factory.mktemp("victoria")
    vehicle_world.write(folder, vehicle_drive, 2)
    return import_adapter(folder, "victoria-park")


def test_trees_of_the_vehicle_data_are_where_they_stand(park: Recording, vehicle_drive: Any) -> None:
    poses, at = vehicle_drive.poses, park.time_s - 5.0  # the files' clock starts at 5 s
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    true = np.column_stack([np.interp(at, vehicle_drive.time_s, column) for column in columns])
    m, truth = park.measurements, true[park.measurements.snapshot]
    towards = truth[:, 2] + m.azimuth_rad
    seen = truth[:, :2] + m.distance_m[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    error = cKDTree(vehicle_drive.trees[:, :2]).query(seen)[0]
    assert np.quantile(error, 0.99) < 0.25 and 7.0 < len(m) / len(park.time_s) < 11.0
    assert park.plane and np.isnan(m.elevation_rad).all() and np.isnan(m.snr_db).all()
    assert np.isnan(park.odometry[:, [2, 4, 5]]).all() and park.reference is not None
    assert park.start_pose[:2] == pytest.approx(true[0, :2], abs=0.8)
    assert park.start_pose[3] == pytest.approx(true[0, 2], abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "times"), [("fastslam", {"particles": 100}, 10), ("ekf-slam", {"vts": 600}, 8)]
)
def test_filters_beat_dead_reckoning_among_500_trees(
    name: str, options: dict[str, int], times: int, park: Recording, position_rmse: Rmse
) -> None:
    """CELLSLAM_VEHICLE_S=3600 makes it the drive of an hour."""
    assert position_rmse(park, name, **options, **FITTED) < position_rmse(park, "dead-reckoning") / times


def test_vehicle_files_that_lack_something(tmp_path: Path) -> None:
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


SOURCES = np.array([[9.0, 1.0], [-25.0, 1.0], [9.0, 13.0], [9.0, -15.0]])  # a transmitter and its mirror images


def test_the_60_ghz_campaign(tmp_path: Path, position_rmse: Rmse) -> None:
    """A file in the layout of the 60 GHz campaign: 45 places in a hall, a transmitter, three walls."""
    rng = np.random.default_rng(7)
    angle = np.linspace(0, 1.5 * np.pi, 45)
    rx = np.stack([6 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2])
    y, power = np.empty((1, 45), object), np.empty((1, 45), object)
    for k in range(45):
        d = SOURCES - rx[:2, k]
        arrival = np.arctan2(d[:, 1], d[:, 0]) - rx[2, k] + np.radians(1.0) * rng.standard_normal(4)
        y[0, k] = np.stack([np.hypot(*d.T) + 0.1 * rng.standard_normal(4), rng.uniform(-3, 3, 4), arrival + 4 * np.pi])
        power[0, k] = rng.uniform(-90, -50, (1, 4))
    savemat(tmp_path / NAME, {"sim": {"rx": rx, "tx": np.tile([[9.0], [1.0], [0.0]], 45), "y": y, "power": power}})
    r = import_adapter(tmp_path, "tampere-60ghz")
    assert len(r.time_s) == 45 and len(r.measurements) == 180 and r.plane
    assert r.reference is not None and np.isfinite(r.reference.yaw_rad).all()
    pose, m = np.column_stack([r.reference.position_m[:, :2], r.reference.yaw_rad]), r.measurements
    towards = pose[m.snapshot, 2] + m.azimuth_rad
    ends = pose[m.snapshot, :2] + m.distance_m[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    assert np.quantile(cKDTree(SOURCES).query(ends)[0], 0.95) < 1.2
    assert "simulated" in r.provenance["description"]
    assert position_rmse(r, "fastslam", particles=100, noise_model="claimed") < position_rmse(r, "dead-reckoning")


def test_a_60_ghz_file_that_lacks_something(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no Kampusareena"):
        import_adapter(tmp_path, "tampere-60ghz")
    savemat(tmp_path / NAME, {"sim": {"rx": np.zeros((3, 2))}})
    with pytest.raises(InputError, match="'sim' has no field 'tx'"):
        import_adapter(tmp_path, "tampere-60ghz")
