"""Adapter for UWB ranges: a robot or a drone that ranges to anchors, whose places are known or not.

Two layouts of a folder:

- `ranges.csv` (columns t in s, id, range in m; std in m if there is one), `anchors.csv` (id, x, y, z in m), and
  trajectories of TUM's format, `groundtruth.tum` and `odometry.tum`: poses in a frame of the odometry's own.
- That of UTIL: one CSV file of event streams, each group of columns with times of its own (`t_twr`, `id`, `twr_meas` in
  m; `t_gyro`, `gyro_z` in deg/s; `t_pose`, `pose_x` to `pose_qw`), and a `.npz` file with `an_pos` (A, 3) in m. Its
  time differences (`t_tdoa`) are no ranges, and refused.

Sources: W. Zhao, A. Goudar, X. Qiao and A. Schoellig, UTIL: an ultra-wideband time-difference-of-arrival indoor
localization dataset, International Journal of Robotics Research, 2024; J. Sturm et al., A benchmark for the evaluation
of RGB-D SLAM systems, IROS 2012 (TUM's trajectories).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.recordings.adapters import shared
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.recordings.importing.tables import TableFile
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

RANGES = {"time_s": {"t": 1.0}, "id": {"id": 1.0}, "distance_m": {"range": 1.0}, "distance_std_m": {"std": 1.0}}
ANCHORS = {"id": {"id": 1.0}, "x": {"x": 1.0}, "y": {"y": 1.0}, "z": {"z": 1.0}}
POSE = ("t_pose", "pose_x", "pose_y", "pose_z", "pose_qx", "pose_qy", "pose_qz", "pose_qw")
# Of odometry of a small robot; and without one, how a small robot or drone moves: speeds that change by 0.5 m/s in 1 s.
SHEET = {
    "noise_density": (0.05, 0.02, 0.02, 0.02, 0.0, 0.0),
    "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0),
    "scale": (0.03, 0.0, 0.0, 0.03, 0.0, 0.0),
}
MOVES = {"noise_density": (0.5, 0.5, 0.2, 0.02, 0.0, 0.0), "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0)}


def load(folder: Path, *, sites: str = "known") -> Campaign:
    """Return the campaign of a folder; `sites`: where the anchors stand is "known" to the estimators, or "unknown".
    Raises InputError."""
    tables = (folder / "ranges.csv").is_file()
    campaign = _of_tables(folder) if tables else _of_streams(folder)
    if not shared.is_known("sites", sites):
        return campaign
    places = shared.anchors(folder, ANCHORS) if tables else _anchors_of_survey(folder)
    return replace(campaign, site_surveys=shared.surveyed(campaign.link_sites, places))


def _of_tables(folder: Path) -> Campaign:
    """Return the campaign of CSV tables and TUM trajectories."""
    columns = shared.named(folder / "ranges.csv", RANGES, optional=("distance_std_m",))
    truth, odometry = folder / "groundtruth.tum", folder / "odometry.tum"
    return _campaign(
        folder, columns.pop("time_s"), columns.pop("id"), columns,
        shared.pose_odometry(*shared.trajectory(odometry)) if odometry.is_file() else None,
        shared.trajectory(truth) if truth.is_file() else None,
    )  # fmt: skip


def _of_streams(folder: Path) -> Campaign:
    """Return the campaign of a CSV file of event streams."""
    path = shared.only(folder, "*.csv")
    stream, drift = TableFile(path), None
    names = stream.names
    if "t_twr" not in names:
        what = "time differences of arrival (t_tdoa), which are no ranges" if "t_tdoa" in names else "no column t_twr"
        raise InputError(f"{path}: holds {what}; give a recording of two-way ranging (t_twr, id, twr_meas)")
    times, number, distance = _group(stream, ("t_twr", "id", "twr_meas")).T
    if "t_gyro" in names:
        gyro = shared.increasing(_group(stream, ("t_gyro", "gyro_z")))
        drift = OdometryTable(gyro[:, 0], {"u_psi": np.radians(gyro[:, 1])})
    truth = None
    if "t_pose" in names:
        rows = shared.increasing(_group(stream, POSE))
        truth = rows[:, 0], shared.poses_of(path, rows[:, 1:4], rows[:, 4:])
    ident = np.array([str(int(each)) for each in number])
    return _campaign(folder, times, ident, {"distance_m": distance}, drift, truth)


def _anchors_of_survey(folder: Path) -> dict[str, Floats]:
    """Return the places (3,) in m of anchors by their number."""
    path = shared.only(folder, "*.npz")
    with np.load(path) as file:
        if "an_pos" not in file:
            raise InputError(f"{path}: has no array 'an_pos' (it has: {', '.join(file)}); give the survey's own file")
        return {str(i): place for i, place in enumerate(np.asarray(file["an_pos"], np.float64))}


def _campaign(
    folder: Path, time_s: Floats, ident: Any, columns: dict[str, Floats], odometry: OdometryTable | None,
    truth: tuple[Floats, Floats] | None,
) -> Campaign:  # fmt: skip
    """Return the campaign of ranges (M,); `truth`: times (R,) and poses (R, 6)."""
    names, link = np.unique(ident, return_inverse=True)
    moves = odometry is not None and "u_x" in odometry.components
    return Campaign(
        time_s=time_s,
        columns=columns,
        link=link,
        link_sites=names.tolist(),
        odometry=odometry,
        noise=SHEET if moves else MOVES,
        start_pose=(0.0,) * 6 if truth is None else None,
        reference=None if truth is None else ReferenceTable(truth[0], truth[1][:, :3], truth[1][:, 3]),
        about={"campaign": "UWB", "description": folder.name},
    )


def _group(stream: TableFile, columns: tuple[str, ...]) -> Floats:
    """Return the rows (N, C) of one event stream, whose columns end earlier than those of others."""
    rows = np.column_stack([stream.numbers(name) for name in columns])
    kept: Floats = rows[np.isfinite(rows).all(axis=1)]
    if not len(kept):
        raise InputError(f"{stream.path}: {', '.join(columns)} have no row")
    return kept
