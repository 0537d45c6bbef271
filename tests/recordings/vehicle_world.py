"""A synthetic drive in the layout of the vehicle data set: an Ackermann vehicle, a laser, trees, GPS fixes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
WHEELBASE_M, ENCODER_M, LASER_X_M, LASER_Y_M = 2.83, 0.76, 3.78, 0.5
ODOMETRY_S, LASER_EVERY, GPS_EVERY = 0.025, 9, 40  # 40 Hz, 4.4 Hz, 1 Hz
MOST_RANGE_M = 35.0


@dataclass(frozen=True)
class VehicleDrive:
    """`poses` (N, 3) of the laser at the odometry's times; `speed` of the rear left wheel and `steering` as
    measured.
    """

    time_s: Floats
    poses: Floats
    speed: Floats
    steering: Floats
    trees: Floats  # (K, 3): x, y, radius


def drive(duration_s: float, trees: int, seed: int, size_m: float = 240.0) -> VehicleDrive:
    """Return a drive through a park: a vehicle that circles on a ring of ways with chords, and trees beside them."""
    rng = np.random.default_rng(seed)
    count = int(duration_s / ODOMETRY_S) + 1
    rear, steering, speed = _rear_axle(count, size_m, rng)
    heading = rear[:, 2]
    laser = np.column_stack(
        [
            rear[:, 0] + LASER_X_M * np.cos(heading) - LASER_Y_M * np.sin(heading),
            rear[:, 1] + LASER_X_M * np.sin(heading) + LASER_Y_M * np.cos(heading),
            heading,
        ]
    )
    wheel = speed * (1.0 - np.tan(steering) * ENCODER_M / WHEELBASE_M)
    measured_speed = wheel * 1.01 + 0.05 * rng.standard_normal(count)
    measured_steering = steering + np.radians(0.3) + np.radians(1.0) * rng.standard_normal(count)
    forest = _plant(laser[::20, :2], trees, size_m, rng)
    return VehicleDrive(ODOMETRY_S * np.arange(count), laser, measured_speed, measured_steering, forest)


def _rear_axle(count: int, size_m: float, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    poses, steering, speed = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    x, y, heading, angle = 0.2 * size_m, 0.2 * size_m, 0.5, 0.0
    angles = 2.0 * np.pi * np.arange(9) / 9.0
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.15, 0.48, (9, 1))
    places = (0.5 + ring) * size_m
    goal = 0
    for i in range(count):
        poses[i] = x, y, heading
        dx, dy = places[goal] - (x, y)
        if dx * dx + dy * dy < 100.0:
            goal = (goal + int(rng.choice([1, 1, 1, 4]))) % len(places)
        wanted = np.arctan2(dy, dx) - heading
        wanted = np.clip(0.7 * np.arctan2(np.sin(wanted), np.cos(wanted)), -0.5, 0.5)
        angle += np.clip(wanted - angle, -0.4 * ODOMETRY_S, 0.4 * ODOMETRY_S)
        v = 3.0 - 2.0 * abs(angle)
        steering[i], speed[i] = angle, v
        rate = v * np.tan(angle) / WHEELBASE_M
        middle = heading + 0.5 * rate * ODOMETRY_S
        x, y, heading = (
            x + v * np.cos(middle) * ODOMETRY_S,
            y + v * np.sin(middle) * ODOMETRY_S,
            heading + rate * ODOMETRY_S,
        )
    return poses, steering, speed


def _plant(way: Floats, count: int, size_m: float, rng: np.random.Generator) -> Floats:
    from scipy.spatial import cKDTree

    near, trees = cKDTree(way), np.empty((0, 2))
    while len(trees) < count:
        spot = rng.uniform(-0.05, 1.05, 2) * size_m
        if near.query(spot)[0] > 4.0 and (len(trees) == 0 or np.hypot(*(trees - spot).T).min() > 3.0):
            trees = np.vstack([trees, spot])
    return np.column_stack([trees, rng.uniform(0.25, 0.45, count)])


def scans(world: VehicleDrive, rng: np.random.Generator) -> tuple[Floats, NDArray[np.uint16]]:
    """Return times (n,) and ranges (n, 361) in cm, half a degree apart from right to left, 8191 where nothing is."""
    from scipy.spatial import cKDTree

    angles = np.pi * np.arange(361) / 360.0 - 0.5 * np.pi
    index = np.arange(0, len(world.time_s), LASER_EVERY)
    forest = cKDTree(world.trees[:, :2])
    out = np.full((len(index), 361), 8191, np.uint16)
    for row, near in enumerate(forest.query_ball_point(world.poses[index, :2], MOST_RANGE_M)):
        if not near:
            continue
        x, y, heading = world.poses[index[row]]
        trees = world.trees[near]
        range_m, bearing = np.hypot(trees[:, 0] - x, trees[:, 1] - y), np.arctan2(trees[:, 1] - y, trees[:, 0] - x)
        offset = angles[None, :] - (bearing - heading)[:, None]
        offset = np.arctan2(np.sin(offset), np.cos(offset))
        inside = np.abs(offset) < np.arcsin(np.minimum(trees[:, 2] / range_m, 1.0))[:, None]
        root = trees[:, 2][:, None] ** 2 - (range_m[:, None] * np.sin(offset)) ** 2
        hit = np.where(inside, range_m[:, None] * np.cos(offset) - np.sqrt(np.maximum(root, 0.0)), np.inf)
        nearest = hit.min(axis=0) + 0.02 * rng.standard_normal(361)
        seen = np.isfinite(nearest)
        out[row, seen] = np.round(100.0 * nearest[seen]).astype(np.uint16)
    return world.time_s[index], out


def files(world: VehicleDrive, rng: np.random.Generator, detected: bool) -> dict[str, dict[str, Any]]:
    """Return the variables of the data set's .mat files: times in ms, columns; without the scans if `detected`."""
    start_ms = 5000.0
    out: dict[str, dict[str, Any]] = {}
    if not detected:
        laser_s, ranges = scans(world, rng)
        out["aa3_lsr2"] = {"TLsr": (start_ms + 1000.0 * laser_s + 7.0).astype(np.uint32)[:, None], "LASER": ranges}
    gps = np.arange(0, len(world.time_s), GPS_EVERY)
    fixes = world.poses[gps, :2] + 0.3 * rng.standard_normal((len(gps), 2))
    return out | {
        "aa3_dr": {
            "time": (start_ms + 1000.0 * world.time_s)[:, None],
            "speed": world.speed[:, None],
            "steering": world.steering[:, None],
        },
        "aa3_gpsx": {
            "timeGps": (start_ms + 1000.0 * world.time_s[gps])[:, None],
            "Lo_m": fixes[:, :1],
            "La_m": fixes[:, 1:],
        },
    }


def detections(world: VehicleDrive, rng: np.random.Generator) -> Floats:
    """Return rows (n, 4) of `measurements.dat`: s since the log began, m, rad (pi/2 ahead), trunk diameter in m."""
    rows = []
    for i in range(0, len(world.time_s), LASER_EVERY):
        x, y, heading = world.poses[i]
        dx, dy = world.trees[:, 0] - x, world.trees[:, 1] - y
        bearing = np.arctan2(dy, dx) - heading
        bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
        seen = (np.hypot(dx, dy) < MOST_RANGE_M) & (np.abs(bearing) < 1.5) & (rng.random(len(dx)) < 0.8)
        range_m, ahead = np.hypot(dx, dy)[seen], bearing[seen] + 0.5 * np.pi
        noise = rng.standard_normal((2, len(ahead)))
        columns = (range_m + 0.1 * noise[0], ahead + 0.005 * noise[1], 2.0 * world.trees[seen, 2])
        rows.append(np.column_stack([np.full(len(ahead), world.time_s[i]), *columns]))
    return np.vstack(rows)


def write(folder: Path, world: VehicleDrive, seed: int, detected: bool = False) -> None:
    """Write the three .mat files, or `measurements.dat` in place of the scans."""
    from scipy.io import savemat

    rng = np.random.default_rng(seed)
    for name, variables in files(world, rng, detected).items():
        savemat(folder / f"{name}.mat", variables)
    if detected:
        np.savetxt(folder / "measurements.dat", detections(world, rng), "%10.5f")
