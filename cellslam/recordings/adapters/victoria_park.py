"""Adapter for the Victoria Park data set: trees in laser scans, wheel speed and steering, GPS.

Files `aa3_dr.mat` (time in ms, speed in m/s, steering in rad), `aa3_gpsx.mat` (timeGps in ms; Lo_m east, La_m north, in
m), and the trees: either `measurements.dat`, as the data set circulates among SLAM programs (text, a row a tree: time
in s since the log began, range in m, bearing in rad where pi/2 is straight ahead, trunk diameter in m), or the scans
`aa3_lsr2.mat` (TLsr in ms; LASER, 361 ranges in cm, half a degree apart from right to left, the lower 13 bits of each
word). Source: J. Guivant and E. Nebot, Optimization of the simultaneous localization and map building algorithm, 2001,
and the vehicle's model that comes with the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cellslam.recordings.adapters.shared import matrix
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.matlab import variables
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints

# The vehicle: wheelbase, encoder left of the rear axle's middle, laser and GPS antenna before and left of that middle.
WHEELBASE_M, ENCODER_M, LASER_X_M, LASER_Y_M = 2.83, 0.76, 3.78, 0.5
RANGE_BITS = 0x1FFF
DETECTED = "measurements.dat"
CENTIMETRE = 0.01
MILLISECOND = 1e-3
# Against a good trajectory the yaw rate errs by 4 %, 0.005 rad/s and 0.0135 rad times root second; its errors move
# the laser to the side, LASER_X_M before the axle.
SHEET = {
    "noise_density": (0.1, LASER_X_M * 0.0135, 0.0, 0.0135, 0.0, 0.0),
    "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0),
    "scale": (0.03, 0.0, 0.0, 0.05, 0.0, 0.0),
}
# What is taken for a trunk: between these ranges; its beams jump by no more; no wider; not at the edge of the scan.
LEAST_RANGE_M, MOST_RANGE_M, JUMP_M, MOST_DIAMETER_M, MARGIN_RAD = 1.0, 75.0, 1.5, 1.0, np.radians(2.5)
LEAST_BEAMS = 2
STEP_RAD = np.pi / 360.0


@dataclass(frozen=True)
class Trees:
    """One row a tree: scan, range and bearing of its centre (bearing 0 ahead, positive to the left), diameter."""

    scan: Ints
    range_m: Floats
    bearing_rad: Floats
    diameter_m: Floats


def load(folder: Path) -> Campaign:
    """Return the campaign of the three files in `folder`, with GPS as the reference. Raises InputError."""
    drive = variables(folder / "aa3_dr.mat", ("time", "speed", "steering"))
    gps = variables(folder / "aa3_gpsx.mat", ("timeGps", "Lo_m", "La_m"))
    drive_s = MILLISECOND * np.asarray(drive["time"], np.float64).ravel()
    fixes = np.column_stack([np.ravel(gps["Lo_m"]), np.ravel(gps["La_m"])]).astype(np.float64)
    fixes_s = MILLISECOND * np.asarray(gps["timeGps"], np.float64).ravel()
    kept = np.append(True, np.diff(fixes_s) > 0)
    detected = folder / DETECTED
    rows_s, range_m, bearing_rad, scans_s = (
        _detected(detected, min(drive_s[0], fixes_s[0])) if detected.is_file() else _scanned(folder)
    )
    # Only while the odometry runs.
    rows = (rows_s >= drive_s[0]) & (rows_s <= drive_s[-1])
    if not rows.any():
        raise InputError(f"{folder}: no tree was seen while the odometry ran: are the files of one drive?")
    return Campaign(
        time_s=rows_s[rows],
        columns={"distance_m": range_m[rows], "azimuth_rad": bearing_rad[rows]},
        snapshots_s=scans_s[(scans_s >= drive_s[0]) & (scans_s <= drive_s[-1])],
        odometry=OdometryTable(drive_s, velocities(np.ravel(drive["speed"]), np.ravel(drive["steering"]))),
        link_sites=("trees",),
        noise=SHEET,
        reference=ReferenceTable(fixes_s[kept], fixes[kept]),
        plane=True,
        scatterers=False,  # landmarks are measured themselves
        range_scale_std=0.0,  # a laser's pulses are timed to centimetres at any distance
        about={"campaign": "Victoria Park"},
    )


def _detected(path: Path, begin_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return time, range and bearing of each tree and the times of the scans that saw one, of `measurements.dat`."""
    table = matrix(path, ("time", "range", "bearing", "diameter"))
    times = begin_s + table[:, 0]
    return times, table[:, 1], table[:, 2] - 0.5 * np.pi, np.unique(times)


def _scanned(folder: Path) -> tuple[Floats, Floats, Floats, Floats]:
    """Return time, range and bearing of each tree and the times of all scans, of `aa3_lsr2.mat`."""
    path = folder / "aa3_lsr2.mat"
    if not path.is_file():
        raise InputError(f"{folder}: holds neither {DETECTED} nor {path.name}: download one of them into it")
    laser = variables(path, ("TLsr", "LASER"))
    scans = np.asarray(laser["LASER"])
    if scans.ndim != 2 or scans.shape[1] != 361:
        raise InputError(f"{path}: LASER has shape {scans.shape}, expected (scans, 361)")
    times = MILLISECOND * np.asarray(laser["TLsr"], np.float64).ravel()
    once = np.append(True, np.diff(times) > 0)
    times = times[once]
    trees = find_trees(CENTIMETRE * (scans[once].astype(np.int64) & RANGE_BITS))
    return times[trees.scan], trees.range_m, trees.bearing_rad, times


def find_trees(ranges_m: ArrayLike) -> Trees:
    """Return the trunks in scans (S, 361) of ranges in metres, half a degree apart from right (-90) to left (+90 deg).

    A segment ends where the next beam hits nothing or jumps by more than JUMP_M. It is a trunk if it is no wider
    than MOST_DIAMETER_M, as deep as a round thing of its width can be, lies inside the scan, and neither neighbour
    stands before it (its edge would be hidden). Diameter: range times the angle of its beams; centre: mean range plus
    pi/4 of the radius, the mean depth of a circle over evenly spread chords.
    """
    r = np.asarray(ranges_m, np.float64)
    scan, beam = np.nonzero((r > LEAST_RANGE_M) & (r < MOST_RANGE_M))
    if not len(scan):
        return Trees(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))
    value = r[scan, beam]
    follows = (np.diff(scan) == 0) & (np.diff(beam) == 1)
    cut = ~follows | (np.abs(np.diff(value)) > JUMP_M)
    first = np.flatnonzero(np.append(True, cut))
    last = np.append(first[1:], len(value)) - 1
    beams = last - first + 1
    mean = np.add.reduceat(value, first) / beams
    depth = np.maximum.reduceat(value, first) - np.minimum.reduceat(value, first)
    diameter = mean * 2.0 * np.tan(0.5 * STEP_RAD * beams)
    after, before = np.append(follows, False), np.append(False, follows)
    hidden = after[last] & (value[np.minimum(last + 1, len(value) - 1)] < value[last])
    hidden |= before[first] & (value[first - 1] < value[first])
    bearing = 0.5 * (beam[first] + beam[last]) * STEP_RAD - 0.5 * np.pi
    trunk = (beams >= LEAST_BEAMS) & (diameter <= MOST_DIAMETER_M) & (depth <= diameter + 0.1)
    trunk &= (np.abs(bearing) < 0.5 * np.pi - MARGIN_RAD) & ~hidden
    centre = mean + 0.125 * np.pi * diameter
    return Trees(scan[first][trunk].astype(np.int64), centre[trunk], bearing[trunk], diameter[trunk])


def velocities(speed_mps: Floats, steering_rad: Floats) -> dict[str, Floats]:
    """Return velocities of the laser, in m/s and rad/s, from the rear left wheel's speed and the steering angle (N,).

    v = v_wheel / (1 - H tan(alpha) / L), omega = v tan(alpha) / L, u = (v - b omega, a omega).
    """
    tangent = np.tan(steering_rad)
    v = speed_mps / (1.0 - tangent * ENCODER_M / WHEELBASE_M)
    turn = v * tangent / WHEELBASE_M
    return {"u_x": v - LASER_Y_M * turn, "u_y": LASER_X_M * turn, "u_psi": turn}
