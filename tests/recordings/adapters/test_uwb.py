"""The layouts of UWB ranges, written from a simulated drive: tables with TUM trajectories, and UTIL's event streams."""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

ANCHORS = {"3": (-12.0, 9.0, 2.4), "7": (22.0, 14.0, 0.3), "21": (16.0, -16.0, 2.0), "4": (-14.0, -12.0, 1.0)}
HEIGHT_M, EVERY = 0.4, 5


def ranged(drive: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, names of anchors and ranges, polled one after the other."""
    at = np.arange(2, len(drive.time_s), EVERY)
    names = np.array(list(ANCHORS))[np.arange(len(at)) % 4]
    places = np.array([ANCHORS[name] for name in names])
    here = np.column_stack([drive.poses[at, :2], np.full(len(at), HEIGHT_M)])
    noise = 0.1 * np.random.default_rng(4).standard_normal(len(at))
    return drive.time_s[at], names, np.linalg.norm(places - here, axis=1) + noise


def poses_of(drive: Any, at: np.ndarray, drift_radps: float = 0.0) -> np.ndarray:
    """Return rows of TUM's format; `drift_radps` bends the track, as a gyro bias does."""
    bent = drift_radps * drive.time_s
    step = np.diff(drive.poses[:, :2], axis=0, prepend=drive.poses[:1, :2])
    step = np.column_stack(
        [np.cos(bent) * step[:, 0] - np.sin(bent) * step[:, 1], np.sin(bent) * step[:, 0] + np.cos(bent) * step[:, 1]]
    )
    place = drive.poses[0, :2] + np.cumsum(step, axis=0)
    q = Rotation.from_euler("Z", (drive.poses[:, 2] + bent)[:, None]).as_quat()
    return np.column_stack([drive.time_s, place, np.full(len(bent), HEIGHT_M), q])[at]


def write_tables(folder: Path, drive: Any) -> None:
    rows = "".join(f"{t:.3f},{name},{r:.4f}\n" for t, name, r in zip(*ranged(drive), strict=True))
    (folder / "ranges.csv").write_text("t,id,range\n" + rows)
    (folder / "anchors.csv").write_text(
        "id,x,y,z\n" + "".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in ANCHORS.items())
    )
    at = np.arange(0, len(drive.time_s), 10)
    np.savetxt(folder / "groundtruth.tum", poses_of(drive, at), header="timestamp tx ty tz qx qy qz qw")
    np.savetxt(folder / "odometry.tum", poses_of(drive, at, 0.004))


def write_streams(folder: Path, drive: Any, ranges: str = "t_twr,id,twr_meas") -> None:
    time, name, r = ranged(drive)
    number = {"3": 0, "7": 1, "21": 2, "4": 3}
    groups = [
        zip(time, [number[each] for each in name], r, strict=True),
        zip(drive.time_s, np.degrees(drive.turn), strict=True),
        poses_of(drive, np.arange(0, len(drive.time_s), 5)).tolist(),
    ]
    head = f"{ranges},t_gyro,gyro_z,t_pose,pose_x,pose_y,pose_z,pose_qx,pose_qy,pose_qz,pose_qw\n"
    lines = ([*(a or [""] * 3), *(b or [""] * 2), *(c or [""] * 8)] for a, b, c in zip_longest(*groups, fillvalue=None))
    (folder / "flight.csv").write_text(head + "".join(",".join(map(str, line)) + "\n" for line in lines))
    np.savez(folder / "anchor_const1.npz", an_pos=np.array(list(ANCHORS.values())))


@pytest.fixture(scope="module")
def drive(drive_eights: Callable[..., Any]) -> Any:
    return drive_eights(100.0, 0.8, 0.12)


def misfit(r: Recording, drive: Any, places: dict[str, Any]) -> float:
    """Return the largest difference in m of the ranges to those between anchors and the true places."""
    at = np.array([places[name] for name in r.sites.name])[r.measurements.link]
    here = np.column_stack([drive.at(r.time_s)[r.measurements.snapshot, :2], np.full(len(at), HEIGHT_M)])
    return float(np.abs(np.linalg.norm(at - here, axis=1) - r.measurements.distance_m).max())


@pytest.mark.slow
def test_tables_and_trajectories(drive: Any, tmp_path: Path, position_rmse: Callable[..., float]) -> None:
    write_tables(tmp_path, drive)
    r = import_adapter(tmp_path, "uwb")
    assert r.sites.name == ("21", "3", "4", "7") and misfit(r, drive, ANCHORS) < 0.6
    assert r.sites.position_m is not None
    assert np.array_equal(r.sites.position_m, [ANCHORS[name] for name in r.sites.name])
    assert r.start_pose[[2, 3]] == pytest.approx([HEIGHT_M, drive.poses[0, 2]], abs=0.02)
    alone = position_rmse(r, "dead-reckoning")
    assert 0.5 < alone < 6.0  # what the bent track amounts to
    assert position_rmse(r, "ekf-slam") < 0.3 * alone
    unknown = import_adapter(tmp_path, "uwb", {"sites": "unknown"})
    assert unknown.sites.position_m is None and np.array_equal(unknown.measurements.link, r.measurements.link)


def test_event_streams(drive: Any, tmp_path: Path) -> None:
    write_streams(tmp_path, drive)
    r = import_adapter(tmp_path, "uwb")
    assert misfit(r, drive, {str(i): place for i, place in enumerate(ANCHORS.values())}) < 0.6
    assert np.isnan(r.odometry[1:, 0]).all() and r.odometry_model.noise_density[0] > 0.0
    turned = np.diff(np.unwrap(drive.at(r.time_s)[:, 2])) / np.diff(r.time_s)
    assert r.odometry[1:, 3] == pytest.approx(turned, abs=0.02)
    assert r.reference is not None and len(r.reference) == len(drive.time_s[::5])


def test_what_does_not_fit_is_said(drive: Any, tmp_path: Path) -> None:
    write_streams(tmp_path, drive, "t_tdoa,idA,tdoa_meas")
    with pytest.raises(InputError, match="time differences of arrival"):
        import_adapter(tmp_path, "uwb")
    write_tables(tmp_path, drive)
    (tmp_path / "anchors.csv").write_text("id,x,y,z\n3,0,0,0\n")
    with pytest.raises(InputError, match="anchor '21' has ranges but no position"):
        import_adapter(tmp_path, "uwb")
    late = np.loadtxt(tmp_path / "odometry.tum")
    late[:, 0] += 1.4e9
    np.savetxt(tmp_path / "odometry.tum", late)
    with pytest.raises(InputError, match=r"odometry lasts from 14000\d+.* measurements from 0.* they share no time"):
        import_adapter(tmp_path, "uwb", {"sites": "unknown"})
