"""Victoria Park with its trees already detected, as text: synthetic files of the same layout, and the real ones."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.victoria_park import DETECTED
from cellslam.recordings.importing.odometry import OdometryTable, motion_of
from cellslam.recordings.importing.start_pose import start_from_reference
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Reference
from tests.recordings import vehicle_world

DATA = Path(os.environ.get("CELLSLAM_DATA", Path(__file__).parents[4] / "shared" / "data")) / "victoria-park"


@pytest.fixture(scope="module")
def circulating(vehicle_drive: object, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder as it circulates: odometry, GPS, and `measurements.dat` in place of the scans."""
    folder = tmp_path_factory.mktemp("circulating")
    vehicle_world.write(folder, vehicle_drive, 2, detected=True)
    return folder


@pytest.mark.slow
def test_detected_trees_take_the_place_of_the_scans(
    circulating: Path, vehicle_drive: Any, position_rmse: Callable[..., float]
) -> None:
    r = import_adapter(circulating, "victoria-park")
    assert not (circulating / "aa3_lsr2.mat").exists()
    drive_s, poses = vehicle_drive.time_s, vehicle_drive.poses
    x, y, yaw = (np.interp(r.time_s - 5.0, drive_s, c) for c in (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])))
    m = r.measurements
    towards = yaw[m.snapshot] + m.azimuth_rad
    places = np.column_stack([x, y])[m.snapshot] + m.distance_m[:, None] * np.column_stack(
        [np.cos(towards), np.sin(towards)]
    )
    trees = vehicle_drive.trees[:, :2]
    apart = np.array([np.hypot(*(trees - place).T).min() for place in places[::7]])
    assert np.quantile(apart, 0.99) < 0.6 and len(apart) > 500
    assert r.odometry_model.scale[3] > 0.0 and r.odometry_model.noise_density[3] == 0.0135
    assert abs(r.start_pose[3] - yaw[0]) < np.radians(3.0)
    assert position_rmse(r, "ekf-slam", vts=600) < 0.2 * position_rmse(r, "dead-reckoning")


def test_a_step_of_the_fixes_does_not_turn_the_start() -> None:
    """Satellites come and go: the fixes of a straight drive stand a metre aside for a while."""
    t, nothing = 0.2 * np.arange(200), np.full(200, np.nan)
    motion = motion_of(OdometryTable(t, {"u_x": np.full(200, 2.0), "u_psi": 0.0 * t}))
    for side in (-1.0, 1.0):
        aside = np.where((t > 7.5) & (t < 25.0), side, 0.0)
        c, s = np.cos(0.6), np.sin(0.6)
        fixes = np.column_stack([2.0 * t * c - aside * s, 2.0 * t * s + aside * c, nothing])
        pose = start_from_reference(motion, Reference(t, fixes, nothing, nothing), 0.0)
        assert abs(pose[3] - 0.6) < np.radians(3.6)


def test_a_table_that_is_none(circulating: Path, tmp_path: Path) -> None:
    for name in ("aa3_dr.mat", "aa3_gpsx.mat"):
        (tmp_path / name).write_bytes((circulating / name).read_bytes())
    with pytest.raises(InputError, match=r"holds neither measurements\.dat nor aa3_lsr2\.mat"):
        import_adapter(tmp_path, "victoria-park")
    (tmp_path / DETECTED).write_text("0.1 2.0 1.5\n")
    with pytest.raises(InputError, match="has 3 columns, expected 4"):
        import_adapter(tmp_path, "victoria-park")
    (tmp_path / DETECTED).write_text("<html>\n")
    with pytest.raises(InputError, match="not a table of numbers"):
        import_adapter(tmp_path, "victoria-park")
    (tmp_path / DETECTED).write_text("9000.0 2.0 1.5 0.3\n")
    with pytest.raises(InputError, match="no tree was seen while the odometry ran"):
        import_adapter(tmp_path, "victoria-park")


@pytest.mark.skipif(not DATA.is_dir(), reason="the data set is not here; CELLSLAM_DATA names the folder that has it")
def test_the_park_itself(position_rmse: Callable[..., float]) -> None:
    """Known: 52 974 trees, 26 minutes, a start heading of 35.3 to 35.5 degrees, 148 m of dead reckoning."""
    r = import_adapter(DATA, "victoria-park")
    assert 52_900 < len(r.measurements) <= 52_974 and r.reference is not None
    assert np.degrees(r.start_pose[3]) == pytest.approx(35.4, abs=0.3)
    assert 140.0 < position_rmse(r, "dead-reckoning") < 156.0
