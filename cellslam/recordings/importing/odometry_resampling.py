"""Odometry at its own rate, as mean body velocities between snapshots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.recordings.importing.campaign import OdometryTable
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.recording import COMPONENTS, Floats

HOLDS = ("next", "before", "linear")
LONGEST_HOLD = 5.0  # a sample is taken to be valid for so many median intervals at most; then nothing was measured
STILL = 1e-9  # m/s and rad/s: a component that the odometry does not have, and that its motion does not amount to


@dataclass(frozen=True)
class Motion:
    """Velocities held constant over intervals: `edges_s` (N + 1,), `velocity` (N, 6), NaN where not measured.

    `measured` (6,): which components the odometry has at all.
    """

    edges_s: Floats
    velocity: Floats
    measured: tuple[bool, ...]
    lever_arm_m: tuple[float, ...] = (0.0, 0.0, 0.0)


def motion_of(table: OdometryTable) -> Motion:
    """Return an odometry table as velocities held over intervals. Raises InputError naming column and row."""
    times = np.asarray(table.time_s, np.float64)
    for name in table.components:
        if name not in COMPONENTS:
            near = nearest_name(name, COMPONENTS)
            raise InputError(f"odometry: unknown component '{name}'{near} (known: {', '.join(COMPONENTS)})")
    if not table.components or len(times) < (1 if table.hold == "before" else 2):
        raise InputError("odometry needs one component and two rows at least: leave the table out if there is none")
    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        raise InputError(f"odometry.time_s, row {bad[0]}: is {times[bad[0]]}, not a number; leave the row out")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise InputError(f"odometry.time_s, row {late[0] + 1}: is not after the row before it: sort by time")
    if table.hold not in HOLDS:
        raise InputError(f"odometry.hold = '{table.hold}' is not one of {', '.join(HOLDS)}")
    values = np.full((len(times), 6), np.nan)
    for name, column in table.components.items():
        array = np.asarray(column, np.float64)
        if array.shape != times.shape:
            raise InputError(f"odometry.{name} has shape {array.shape}, expected {times.shape}")
        infinite = np.flatnonzero(np.isinf(array))
        if len(infinite):
            raise InputError(f"odometry.{name}, row {infinite[0]}: is infinite; write NaN where nothing was measured")
        values[:, COMPONENTS.index(name)] = array
    return _held(times, values, table.hold, tuple(float(x) for x in table.lever_arm_m))


def _held(times: Floats, values: Floats, hold: str, lever_arm_m: tuple[float, ...]) -> Motion:
    measured = tuple(not np.isnan(column).all() for column in values.T)
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    gap = np.diff(times) > LONGEST_HOLD * step
    if hold == "next":
        edges, velocity = np.append(times, times[-1] + step), values.copy()
        velocity[:-1][gap] = np.nan
    elif hold == "before":
        edges, velocity = np.insert(times, 0, times[0] - step), values.copy()  # means, however long they are of
    else:
        edges, velocity = times, 0.5 * (values[1:] + values[:-1])
        velocity[gap] = np.nan
    return Motion(edges, velocity, measured, lever_arm_m)


def at_array(motion: Motion) -> Motion:
    """Return the motion of the array, which sits `lever_arm_m` from the point that was measured: v + omega x r.

    Yaw, pitch and roll rates stand for the body's angular rates, which holds for small pitch and roll. A velocity that
    the rotation adds to becomes known only if the lever arm and the rate are.
    """
    x, y, z = motion.lever_arm_m
    if x == y == z == 0.0:
        return motion
    velocity = motion.velocity.copy()
    yaw, pitch, roll = (np.nan_to_num(velocity[:, 3 + i]) for i in range(3))
    added = (pitch * z - yaw * y, yaw * x - roll * z, roll * y - pitch * x)
    measured = list(motion.measured)
    for i, extra in enumerate(added):
        if not motion.measured[i] and extra.any():
            velocity[:, i], measured[i] = 0.0, True  # the measured point does not move that way; the array does
        velocity[:, i] += extra
    return Motion(motion.edges_s, velocity, tuple(measured))


def mean_velocities(motion: Motion, times: Floats, start_pose: Floats) -> Floats:
    """Return mean body velocities (T, 6), in m/s and rad/s, between `times` (T,) in s, row 0 zero.

    NaN where less than half was measured. The held velocities are integrated exactly (`frames.integrate_pose` on every
    piece) from the attitude of start_pose (6,). Driving ahead in a turn moves the vehicle to the side of its mean
    heading: a velocity that the odometry does not have is measured where its motion amounts to one.
    """
    out = np.zeros((len(times), 6))
    if np.array_equal(motion.edges_s[1:], times):  # already means between these very times
        out[1:] = motion.velocity[1:]
        out[:, np.logical_not(motion.measured)] = np.nan
        return out
    poses, known = integrate(motion, times, start_pose)
    out[1:] = mean_velocity(poses[:-1], poses[1:], np.diff(times))
    measured = np.array(motion.measured)
    absent = np.flatnonzero(np.logical_not(measured))
    amounts = np.abs(out[:, absent]).max(axis=0) > STILL
    known[:, absent] = np.all(known[:, measured], axis=1, keepdims=True)
    out[1:][~known] = np.nan
    out[:, absent[~amounts]] = np.nan
    return out


def integrate(motion: Motion, times: Floats, start_pose: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the dead-reckoned poses (T, 6) at `times` (T,) in s, and for each interval (T - 1, 6) whether it was
    measured.

    Poses in m and rad, from start_pose (6,).
    """
    inside = motion.edges_s[(motion.edges_s > times[0]) & (motion.edges_s < times[-1])]
    knots = np.union1d(times, inside)
    middle = 0.5 * (knots[1:] + knots[:-1])
    piece = np.searchsorted(motion.edges_s, middle, side="right") - 1
    covered = (piece >= 0) & (piece < len(motion.velocity))
    velocity = np.full((len(middle), 6), np.nan)
    velocity[covered] = motion.velocity[piece[covered]]
    dt = np.diff(knots)[:, None]
    at = np.searchsorted(knots, times)
    lasting = np.vstack([np.zeros(6), np.cumsum(np.where(np.isnan(velocity), 0.0, dt), axis=0)])[at]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.diff(lasting, axis=0) / np.diff(times)[:, None]
    # Where part of an interval was not measured, the measured part stands for all of it.
    interval = np.searchsorted(times, middle, side="right") - 1
    scale = 1.0 / np.maximum(share, 0.5)
    turned = np.nan_to_num(velocity) * scale[np.clip(interval, 0, len(share) - 1)] * dt
    attitude = start_pose[3:] + np.vstack([np.zeros(3), np.cumsum(turned[:, 3:], axis=0)])
    half = 0.5 * (attitude[1:] + attitude[:-1])
    moved = np.einsum("nij,nj->ni", rotation(half[:, 0], half[:, 1], half[:, 2]), turned[:, :3])
    place = start_pose[:3] + np.vstack([np.zeros(3), np.cumsum(moved, axis=0)])
    return np.column_stack([place, attitude])[at], share >= 0.5
