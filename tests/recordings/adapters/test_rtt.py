"""Ranges in plain tables, written from a simulated walk: Wi-Fi round-trip times of a phone, 5G times of arrival."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

POINTS = {"aa:10": (-12.0, 9.0, 2.5), "aa:02": (22.0, 14.0, 2.5), "aa:ff": (16.0, -16.0, 2.5)}
EVERY = 20


@pytest.fixture(scope="module")
def drive(drive_eights: Callable[..., Any]) -> Any:
    return drive_eights(80.0, 1.2, 0.12)


def write(folder: Path, drive: Any, head: str, row: Callable[[float, str, float], str]) -> np.ndarray:
    """Write a folder whose rows of ranges are `row` (time in s, name, distance in m); return the true distances."""
    at, true, lines = np.arange(0, len(drive.time_s), EVERY), [], [head]
    for i in at:
        for name, place in POINTS.items():
            true.append(float(np.linalg.norm(np.subtract(place, (*drive.poses[i, :2], 0.0)))))
            lines.append(row(drive.time_s[i], name, true[-1]))
    (folder / "ranges.csv").write_text("\n".join(lines) + "\n")
    (folder / "anchors.csv").write_text(
        "bssid,x_m,y_m,z_m\n" + "".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in POINTS.items())
    )
    table = np.column_stack([drive.time_s, drive.poses])
    np.savetxt(folder / "reference.csv", table[::25], "%.6f", ",", header="time_s,x_m,y_m,yaw_rad", comments="")
    return np.array(true)


def test_round_trip_times_of_a_phone(drive: Any, tmp_path: Path) -> None:
    failed = iter(range(10_000))
    true = write(
        tmp_path, drive, "timestamp_ms,mac,distance_mm,distance_std_mm,rssi_dbm,status",
        lambda t, name, d: f"{1000 * t:.0f},{name},{1000 * d:.0f},300,-60,{int(next(failed) % 7 == 0)}",
    )  # fmt: skip
    table = np.column_stack([drive.time_s, drive.poses])
    np.savetxt(tmp_path / "odometry.csv", table[::10], "%.6f", ",", header="time_s,x_m,y_m,yaw_rad", comments="")
    r = import_adapter(tmp_path, "rtt")
    kept = np.arange(len(true)) % 7 != 0
    assert len(r.measurements) == kept.sum()
    at = np.array([POINTS[name] for name in r.sites.name])[r.measurements.link]
    here = np.column_stack([drive.at(r.time_s)[r.measurements.snapshot, :2], np.zeros(len(at))])
    assert r.measurements.distance_m == pytest.approx(np.linalg.norm(at - here, axis=1), abs=0.001)
    assert r.measurements.distance_std_m is not None and np.all(r.measurements.distance_std_m == 0.3)
    assert r.sites.position_m is not None and np.array_equal(r.sites.position_m, [POINTS[n] for n in r.sites.name])
    assert np.all(r.sites.clock_offset_std_m == 0.0)
    assert r.odometry[1:, 0] == pytest.approx(np.full(len(r.time_s) - 1, 1.2), abs=0.01)


def test_times_of_arrival_without_surveyed_cells(drive: Any, tmp_path: Path) -> None:
    true = write(
        tmp_path, drive, "time_s,cell,toa_ns",
        lambda t, name, d: f"{t:.2f},{name},{1e9 * (d + 30.0) / SPEED_OF_LIGHT_MPS:.3f}",
    )  # fmt: skip
    speeds = np.column_stack([drive.time_s, drive.speed, np.degrees(drive.turn)])[::5]
    head = "time_s,speed_mps,yaw_rate_degps"
    np.savetxt(tmp_path / "odometry.csv", speeds, "%.6f", ",", header=head, comments="")
    r = import_adapter(tmp_path, "rtt", {"sites": "unknown", "clock_offset_std_m": 50.0})
    assert r.sites.position_m is None and np.all(r.sites.clock_offset_std_m == 50.0)
    assert np.sort(r.measurements.distance_m) == pytest.approx(np.sort(true) + 30.0, abs=0.001)
    assert np.abs(r.odometry[1:, 3]) == pytest.approx(np.full(len(r.time_s) - 1, 0.12), abs=0.13)


def test_what_does_not_fit_is_said(drive: Any, tmp_path: Path) -> None:
    write(tmp_path, drive, "time_s,cell,delay", lambda t, name, d: f"{t},{name},{d}")
    with pytest.raises(InputError, match="has no column distance_m or distance_mm or toa_ns or rtt_ns"):
        import_adapter(tmp_path, "rtt")
    write(tmp_path, drive, "time_s,cell,distance_m,status", lambda t, name, d: f"{t},{name},{d},2")
    with pytest.raises(InputError, match="no row has a distance above zero and status 0"):
        import_adapter(tmp_path, "rtt")
    write(tmp_path, drive, "time_s,cell,distance_m", lambda t, name, d: f"{t},{name},{d}")
    (tmp_path / "odometry.csv").write_text("time_s,speed_mps\n0,1\n1,1\n")
    with pytest.raises(InputError, match="give speed_mps and yaw_rate_radps, or x_m, y_m and yaw_rad"):
        import_adapter(tmp_path, "rtt")
