"""The layout of Victoria Park: trees in scans, or already detected, as text; synthetic files and the real ones."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat
from scipy.spatial import cKDTree

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.victoria_park import DETECTED, find_trees, velocities
from cellslam.recordings.importing.odometry import OdometryTable, motion_of
from cellslam.recordings.importing.start_pose import start_from_reference
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording, Reference
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from tests.recordings import vehicle_world

Rmse = Callable[..., float]
DATA = Path(os.environ.get("CELLSLAM_DATA", Path(__file__).parents[4] / "shared" / "data")) / "victoria-park"
DURATION_S = float(os.environ.get("CELLSLAM_VEHICLE_S", "240"))  # 3600 makes it the drive of an hour
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
def drive() -> vehicle_world.VehicleDrive:
    """Minutes among 500 trees."""
    return vehicle_world.drive(DURATION_S, 500, 1)


@pytest.fixture(scope="module")
def parks(drive: vehicle_world.VehicleDrive, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """The recordings of a drive's three .mat files, and with `measurements.dat` in place of the scans."""
    found = {}
    for kind in ("scans", "detected"):
        folder = tmp_path_factory.mktemp(kind)
        vehicle_world.write(folder, drive, 2, detected=kind == "detected")
        found[kind] = import_adapter(folder, "victoria-park")
    return found


@pytest.mark.parametrize(("kind", "within_m"), [("scans", 0.25), ("detected", 0.6)])
def test_trees_are_where_they_stand(
    kind: str, within_m: float, parks: dict[str, Recording], drive: vehicle_world.VehicleDrive
) -> None:
    r = parks[kind]
    columns = (drive.poses[:, 0], drive.poses[:, 1], np.unwrap(drive.poses[:, 2]))
    at = r.time_s - 5.0  # the files' clock starts at 5 s
    true = np.column_stack([np.interp(at, drive.time_s, column) for column in columns])
    m, pose = r.measurements, true[r.measurements.snapshot]
    towards = pose[:, 2] + m.azimuth_rad
    seen = pose[:, :2] + m.distance_m[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    apart = cKDTree(drive.trees[:, :2]).query(seen)[0]
    assert np.quantile(apart, 0.99) < within_m and 5.0 < len(m) / len(r.time_s) < 15.0
    assert r.plane and np.isnan(r.odometry[:, [2, 4, 5]]).all() and r.reference is not None
    assert r.start_pose[:2] == pytest.approx(true[0, :2], abs=0.8)
    assert r.start_pose[3] == pytest.approx(true[0, 2], abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name", "options", "times"),
    [("scans", "fastslam", {"particles": 100} | FITTED, 10), ("detected", "ekf-slam", {"vts": 600}, 5)],
)
def test_filters_beat_dead_reckoning_among_500_trees(
    kind: str, name: str, options: dict[str, object], times: int, parks: dict[str, Recording], position_rmse: Rmse
) -> None:
    assert position_rmse(parks[kind], name, **options) < position_rmse(parks[kind], "dead-reckoning") / times


def test_a_step_of_the_fixes_does_not_turn_the_start() -> None:
    """Satellites come and go: the fixes of a straight drive stand a metre aside for a while."""
    t, nothing = 0.2 * np.arange(200), np.full(200, np.nan)
    motion = motion_of(OdometryTable(t, {"u_x": np.full(200, 2.0), "u_psi": 0.0 * t}))
    for side in (-1.0, 1.0):
        aside = np.where((t > 7.5) & (t < 25.0), side, 0.0)
        c, s = np.cos(0.6), np.sin(0.6)
        fixes = np.column_stack([2.0 * t * c - aside * s, 2.0 * t * s + aside * c, nothing])
        pose, std = start_from_reference(motion, Reference(t, fixes, nothing, nothing), 0.0)
        assert abs(pose[3] - 0.6) < np.radians(3.6) and np.radians(0.5) < std[3] < np.radians(5.0)


@pytest.mark.usefixtures("mat_files_read_here")
def test_files_that_lack_something(tmp_path: Path) -> None:
    """A text file in place of the scans is looked for first."""
    vehicle_world.write(tmp_path, vehicle_world.drive(30.0, 60, 4, size_m=80.0), 5, detected=True)
    for content, text in (
        ("0.1 2.0 1.5\n", "has 3 columns, expected 4"),
        ("<html>\n", "not a table of numbers"),
        ("9000.0 2.0 1.5 0.3\n", "no tree was seen while the odometry ran"),
        (None, "holds neither measurements.dat nor aa3_lsr2.mat"),
    ):
        (tmp_path / DETECTED).unlink() if content is None else (tmp_path / DETECTED).write_text(content)
        with pytest.raises(InputError, match=text):
            import_adapter(tmp_path, "victoria-park")
    columns = {k: v for k, v in loadmat(tmp_path / "aa3_dr.mat").items() if k[0] != "_"}
    savemat(tmp_path / "aa3_dr.mat", {"stering" if k == "steering" else k: v for k, v in columns.items()})
    with pytest.raises(InputError, match=r"aa3_dr\.mat: no variable 'steering'; did you mean 'stering'"):
        import_adapter(tmp_path, "victoria-park")


@pytest.mark.skipif(not DATA.is_dir(), reason="the data set is not here; CELLSLAM_DATA names the folder that has it")
def test_the_park_itself(position_rmse: Callable[..., float]) -> None:
    """Known: 52 974 trees, 26 minutes, a start heading of 35.3 to 35.5 degrees, 148 m of dead reckoning."""
    r = import_adapter(DATA, "victoria-park")
    assert 52_900 < len(r.measurements) <= 52_974 and r.reference is not None
    assert np.degrees(r.start_pose[3]) == pytest.approx(35.4, abs=0.3)
    assert 140.0 < position_rmse(r, "dead-reckoning") < 156.0
