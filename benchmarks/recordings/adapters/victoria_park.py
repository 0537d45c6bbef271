"""Adapter for the Victoria Park data set: laser scans of trees, wheel speed and steering, GPS.

Files `aa3_dr.mat` (time in ms, speed in m/s, steering in rad), `aa3_lsr2.mat` (TLsr in ms; LASER, 361 ranges in cm,
half a
degree apart from right to left, the lower 13 bits of each word) and `aa3_gpsx.mat` (timeGps in ms; Lo_m east, La_m
north,
in m). Source: J. Guivant and E. Nebot, Optimization of the simultaneous localization and map building algorithm,
2001, and
the vehicle's model that comes with the data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.benchmarks.recordings.adapters.tree_trunks import TreeRules, find_trees
from cellslam.benchmarks.recordings.importing.campaign import Campaign, OdometryTable, ReferenceTable
from cellslam.benchmarks.recordings.importing.campaign_to_recording import build
from cellslam.benchmarks.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Recording

# The vehicle: wheelbase, encoder left of the rear axle's middle, laser and GPS antenna before and left of that middle.
WHEELBASE_M, ENCODER_M, LASER_X_M, LASER_Y_M = 2.83, 0.76, 3.78, 0.5
RANGE_BITS = 0x1FFF
CENTIMETRE = 0.01
MILLISECOND = 1e-3


def load(folder: Path) -> Recording:
    """Return the recording of the three files in `folder`, with GPS as the reference. Raises InputError."""
    drive = variables(folder / "aa3_dr.mat", ("time", "speed", "steering"))
    laser = variables(folder / "aa3_lsr2.mat", ("TLsr", "LASER"))
    gps = variables(folder / "aa3_gpsx.mat", ("timeGps", "Lo_m", "La_m"))
    scans = np.asarray(laser["LASER"])
    if scans.ndim != 2 or scans.shape[1] != 361:
        raise InputError(f"{folder / 'aa3_lsr2.mat'}: LASER has shape {scans.shape}, expected (scans, 361)")
    drive_s = MILLISECOND * np.asarray(drive["time"], np.float64).ravel()
    scans_s = MILLISECOND * np.asarray(laser["TLsr"], np.float64).ravel()
    # Only while the odometry runs, and once for each time.
    used = (scans_s >= drive_s[0]) & (scans_s <= drive_s[-1]) & np.append(True, np.diff(scans_s) > 0)
    ranges = CENTIMETRE * (scans[used].astype(np.int64) & RANGE_BITS)
    trees, scans_s = find_trees(ranges, TreeRules()), scans_s[used]
    fixes = np.column_stack([np.ravel(gps["Lo_m"]), np.ravel(gps["La_m"])]).astype(np.float64)
    fixes_s = MILLISECOND * np.asarray(gps["timeGps"], np.float64).ravel()
    kept = np.append(True, np.diff(fixes_s) > 0)
    return build(
        Campaign(
            time_s=scans_s[trees.scan],
            columns={"distance_m": trees.range_m, "azimuth_rad": trees.bearing_rad},
            snapshots_s=scans_s,
            odometry=OdometryTable(drive_s, velocities(np.ravel(drive["speed"]), np.ravel(drive["steering"]))),
            link_sites=("trees",),
            noise={
                "noise_density": (0.1, 0.03, 0.0, 0.008, 0.0, 0.0),
                "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0),
                "scale": (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
            },
            start_std=(0.2, 0.2, 0.0, np.radians(0.7), 0.0, 0.0),
            reference=ReferenceTable(fixes_s[kept], fixes[kept]),
            plane=True,
            about={"campaign": "Victoria Park"},
        )
    )


def velocities(speed_mps: Floats, steering_rad: Floats) -> dict[str, Floats]:
    """Return velocities of the laser, in m/s and rad/s, from the rear left wheel's speed and the steering angle (N,).

    v = v_wheel / (1 - H tan(alpha) / L), omega = v tan(alpha) / L, u = (v - b omega, a omega).
    """
    tangent = np.tan(steering_rad)
    v = speed_mps / (1.0 - tangent * ENCODER_M / WHEELBASE_M)
    turn = v * tangent / WHEELBASE_M
    return {"u_x": v - LASER_Y_M * turn, "u_y": LASER_X_M * turn, "u_psi": turn}
