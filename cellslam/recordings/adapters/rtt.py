"""Adapter for ranges in plain tables, as phones log Wi-Fi round-trip times and 5G receivers times of arrival.

A folder of text files whose columns say their units. `ranges.csv`: time_s, timestamp_ms or timestamp_ns; mac, bssid,
cell or id; one of distance_m, distance_mm, toa_ns (a delay) and rtt_ns (a delay there and back), with its deviation
where there is one (distance_std_m, ...); status where there is one, 0 for a success. `anchors.csv`: mac, bssid, cell or
id; x_m, y_m, z_m. `odometry.csv` (it may be missing): time; speed_mps and yaw_rate_radps or yaw_rate_degps; or x_m,
y_m, yaw_rad or yaw_deg in a frame of its own. `reference.csv` (it may be missing): time, x_m, y_m.

Sources: IEEE 802.11-2020, 11.21.6 (fine timing measurement); Android, android.net.wifi.rtt.RangingResult (status,
milliseconds, millimetres); 3GPP TS 38.215, 5.1.30 (receive-transmit time differences).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.recordings.adapters.shared import anchors, increasing, is_known, named, planar, pose_odometry, surveyed
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

NANOSECOND_M = 1e-9 * SPEED_OF_LIGHT_MPS
TIME = {"time_s": 1.0, "timestamp_ms": 1e-3, "timestamp_ns": 1e-9}
IDENT = {"mac": 1.0, "bssid": 1.0, "cell": 1.0, "id": 1.0}
DISTANCE = {"distance_m": 1.0, "distance_mm": 1e-3, "toa_ns": NANOSECOND_M, "rtt_ns": 0.5 * NANOSECOND_M}
DEVIATION = {name.replace("_", "_std_"): unit for name, unit in DISTANCE.items()}
RANGES = {
    "time_s": TIME, "id": IDENT, "distance_m": DISTANCE, "distance_std_m": DEVIATION, "status": {"status": 1.0},
}  # fmt: skip
PLACE = {"x": {"x_m": 1.0}, "y": {"y_m": 1.0}, "z": {"z_m": 1.0}}
YAW = {"yaw_rad": 1.0, "yaw_deg": np.pi / 180.0}
SPEEDS = {"u_x": {"speed_mps": 1.0}, "u_psi": {"yaw_rate_radps": 1.0, "yaw_rate_degps": np.pi / 180.0}}
ODOMETRY = {"time_s": TIME, **PLACE, "yaw": YAW, **SPEEDS}
# Of a phone's step counter and gyro; and without odometry, how a person with a phone walks about.
SHEET = {
    "noise_density": (0.15, 0.05, 0.0, 0.02, 0.0, 0.0),
    "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0),
    "scale": (0.1, 0.0, 0.0, 0.03, 0.0, 0.0),
}
WALKS = {"noise_density": (1.0, 1.0, 0.0, 0.0, 0.0, 0.0)}


def load(folder: Path, *, sites: str = "known", clock_offset_std_m: float = 0.0) -> Campaign:
    """Return the campaign of a folder. Raises InputError.

    `sites`: where the anchors stand is "known" to the estimators, or "unknown". `clock_offset_std_m`: deviation of the
    unknown clock offset of each anchor in m, for one-way delays; 0: there and back.
    """
    known = is_known("sites", sites)
    if not clock_offset_std_m >= 0.0:
        raise InputError(f"clock_offset_std_m = {clock_offset_std_m}: give 0 m or more")
    path = folder / "ranges.csv"
    columns = named(path, RANGES, optional=("distance_std_m", "status"))
    good = np.isfinite(columns["distance_m"]) & (columns["distance_m"] > 0.0)
    good &= columns.pop("status", np.zeros(len(good))) == 0.0
    if not good.any():
        raise InputError(f"{path}: no row has a distance above zero and status 0: nothing was measured")
    names, link = np.unique(columns["id"][good], return_inverse=True)
    odometry, truth = _odometry(folder / "odometry.csv"), folder / "reference.csv"
    return Campaign(
        time_s=columns["time_s"][good],
        columns={name: columns[name][good] for name in ("distance_m", "distance_std_m") if name in columns},
        link=link,
        link_sites=names.tolist(),
        site_offsets=dict.fromkeys(names.tolist(), (0.0, clock_offset_std_m)),
        site_surveys=surveyed(names, anchors(folder, {"id": IDENT, **PLACE})) if known else {},
        odometry=odometry,
        noise=WALKS if odometry is None else SHEET,
        start_pose=None if truth.is_file() else (0.0,) * 6,
        reference=_reference(truth) if truth.is_file() else None,
        about={"campaign": "ranges", "description": folder.name},
    )


def _odometry(path: Path) -> OdometryTable | None:
    if not path.is_file():
        return None
    table = named(path, ODOMETRY, optional=tuple(name for name in ODOMETRY if name != "time_s"))
    speeds = [name for name in ("u_x", "u_psi") if name in table]
    if len(speeds) == 2:
        rows = increasing(np.column_stack([table["time_s"], table["u_x"], table["u_psi"]]))
        return OdometryTable(rows[:, 0], {"u_x": rows[:, 1], "u_psi": rows[:, 2]})
    if speeds or any(name not in table for name in ("x", "y", "yaw")):
        raise InputError(f"{path}: give speed_mps and yaw_rate_radps, or x_m, y_m and yaw_rad")
    rows = increasing(np.column_stack([table[name] for name in ("time_s", "x", "y", "yaw")]))
    return pose_odometry(rows[:, 0], planar(rows[:, 1:3], np.unwrap(rows[:, 3])))


def _reference(path: Path) -> ReferenceTable:
    table = named(path, {"time_s": TIME, **PLACE, "yaw": YAW}, optional=("z", "yaw"))
    place = np.column_stack([table[axis] for axis in "xyz" if axis in table])
    return ReferenceTable(table["time_s"], place, table.get("yaw"))
