"""A synthetic drive in the layout of the Victoria Park data: an Ackermann vehicle, a laser, trees, GPS fixes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial import cKDTree

from tests.recordings.mistaken_worlds import STEP_S, Floats, at_arm, paths, way_through

WHEELBASE_M, ENCODER_M, LASER_M = 2.83, 0.76, (3.78, 0.5)
LASER_EVERY, GPS_EVERY = 5, 20  # 4 Hz and 1 Hz
MOST_RANGE_M, BEGIN_S = 35.0, 5.0


@dataclass(frozen=True)
class VehicleDrive:
    """Poses (N, 3) of the laser, speed of the rear left wheel and steering as measured; trees (K, 3): x, y, radius."""

    time_s: Floats
    poses: Floats
    speed: Floats
    steering: Floats
    trees: Floats


def drive(duration_s: float, trees: int, seed: int, size_m: float = 240.0) -> VehicleDrive:
    """Return a drive round and round a park, with trees beside the way."""
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(9) / 9.0
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.15, 0.48, (9, 1))
    rear = way_through((0.5 + ring) * size_m, 3.0, 0.35, duration_s)
    speed = np.hypot(*np.diff(rear[:, :2], axis=0, append=rear[-1:, :2]).T) / STEP_S
    speed[-1] = speed[-2]
    steering = np.arctan(np.gradient(rear[:, 2], STEP_S) * WHEELBASE_M / speed)
    wheel = speed * (1.0 - np.tan(steering) * ENCODER_M / WHEELBASE_M)
    laser = at_arm(rear, LASER_M)
    spots = rng.uniform(-0.05, 1.05, (4 * trees, 2)) * size_m
    spots = spots[cKDTree(laser[:, :2]).query(spots)[0] > 4.0]
    spots = np.delete(spots, cKDTree(spots).query_pairs(3.0, output_type="ndarray")[:, 1], axis=0)[:trees]
    return VehicleDrive(
        STEP_S * np.arange(len(rear)),
        laser,
        wheel * 1.01 + 0.05 * rng.standard_normal(len(rear)),
        steering + np.radians(0.3) + np.radians(1.0) * rng.standard_normal(len(rear)),
        np.column_stack([spots, rng.uniform(0.25, 0.45, len(spots))]),
    )


def scan(pose: Floats, trees: Floats, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return 361 ranges in cm, half a degree apart from right to left, 8191 where nothing is."""
    away = trees[:, :2] - pose[:2]
    near = np.hypot(*away.T) < MOST_RANGE_M
    away, radius = away[near], trees[near, 2:]
    beams = np.pi * np.arange(361) / 360.0 - 0.5 * np.pi + pose[2]
    ahead = away @ [np.cos(beams), np.sin(beams)]
    aside = away @ [-np.sin(beams), np.cos(beams)]
    depth = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    hit = np.where((ahead > 0.0) & (depth > 0.0), ahead - depth, np.inf)
    nearest = hit.min(axis=0, initial=np.inf) + 0.02 * rng.standard_normal(361)
    return np.where(np.isfinite(nearest), np.round(100.0 * nearest), 8191).astype(np.uint16)


def write(folder: Path, world: VehicleDrive, seed: int, detected: bool = False) -> None:
    """Write the three .mat files, times in ms, or `measurements.dat` in place of the scans."""
    rng = np.random.default_rng(seed)
    clock_ms = 1000.0 * (BEGIN_S + world.time_s)[:, None]
    fixes = world.poses[::GPS_EVERY, :2] + 0.3 * rng.standard_normal((len(clock_ms[::GPS_EVERY]), 2))
    savemat(folder / "aa3_gpsx.mat", {"timeGps": clock_ms[::GPS_EVERY], "Lo_m": fixes[:, :1], "La_m": fixes[:, 1:]})
    wheels = {"speed": world.speed[:, None], "steering": world.steering[:, None]}
    savemat(folder / "aa3_dr.mat", {"time": clock_ms} | wheels)
    rows = np.arange(0, len(clock_ms), LASER_EVERY)
    if detected:
        noise = (0.1, 0.005)
        seen = paths(world.poses, rows, world.trees[:, :2], noise, MOST_RANGE_M, 0.8, 0.0, rng, ahead_only=True)
        table = np.column_stack([seen[0], seen[1], seen[2] + 0.5 * np.pi, np.full(len(seen[0]), 0.7)])
        np.savetxt(folder / "measurements.dat", table, "%10.5f")
    else:
        ranges = np.stack([scan(pose, world.trees, rng) for pose in world.poses[rows]])
        savemat(folder / "aa3_lsr2.mat", {"TLsr": clock_ms[rows].astype(np.uint32), "LASER": ranges})
