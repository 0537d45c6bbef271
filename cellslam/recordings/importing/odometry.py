"""Odometry at its own rate, as mean body velocities between snapshots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.recording import COMPONENTS, Floats

HOLDS = ("next", "before", "linear")
LONGEST_HOLD = 5.0  # median intervals for which a sample is valid at most, where nobody says how long it is
STILL = 1e-9  # m/s and rad/s: a component that the odometry does not have, and that its motion does not amount to


@dataclass(frozen=True)
class OdometryTable:
    """Velocities at their own times (N,): components of u by name ("u_x" in m/s, "u_psi" in rad/s, ...), each (N,).

    `hold`: "next", a row is valid until the next row; "before", since the row before; "linear", in between
    interpolate. `valid_s`: the longest time for which a row is valid, after which nothing was measured; None: five
    median intervals. A component that is left out was not measured. `lever_arm_m`: the array in the body frame of the
    point whose velocity this is. `time_constant_s`: these are commands, and with it the vehicle follows them; zero:
    nobody knows it; None: velocities were measured. What is valid for ever is a command: nobody knows how it is
    followed unless `time_constant_s` says so.
    """

    time_s: ArrayLike
    components: Mapping[str, ArrayLike]
    hold: str = "next"
    valid_s: float | None = None
    lever_arm_m: Sequence[float] = (0.0, 0.0, 0.0)
    time_constant_s: float | None = None

    def __post_init__(self) -> None:
        if self.valid_s == np.inf and self.time_constant_s is None:
            object.__setattr__(self, "time_constant_s", 0.0)


@dataclass(frozen=True)
class Motion:
    """Velocities of the array, held constant over intervals: `edges_s` (N + 1,), `velocity` (N, 6), NaN where not
    measured. `measured` (6,): which components the odometry has at all.
    """

    edges_s: Floats
    velocity: Floats
    measured: NDArray[np.bool_]


def column_of(table: str, name: str, values: ArrayLike, count: int | None = None) -> Floats:
    """Return a column (N,) of a table. Raises InputError where it is none, or has not `count` rows."""
    array = np.array(values, np.float64)
    if array.ndim != 1 or (count is not None and len(array) != count):
        raise InputError(f"{table}.{name} has shape {array.shape}, expected ({'N' if count is None else count},)")
    return array


def times_of(table: str, values: ArrayLike, in_order: bool = True) -> Floats:
    """Return the times (N,) of a table. Raises InputError where one is no number, or they are not `in_order`."""
    times = column_of(table, "time_s", values)
    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        raise InputError(f"{table}.time_s, row {bad[0]}: is {times[bad[0]]}, not a number; leave the row out")
    late = np.flatnonzero(np.diff(times) <= 0)
    if in_order and len(late):
        raise InputError(f"{table}.time_s, row {late[0] + 1}: is not after the row before it: sort by time")
    return times


def motion_of(table: OdometryTable) -> Motion:
    """Return an odometry table as the array's velocities over intervals. Raises InputError naming column and row."""
    times = times_of("odometry", table.time_s)
    if not table.components or len(times) < (1 if table.hold == "before" else 2):
        raise InputError("odometry needs one component and two rows at least: leave the table out if there is none")
    if table.hold not in HOLDS:
        raise InputError(f"odometry.hold = '{table.hold}' is not one of {', '.join(HOLDS)}")
    values = np.full((len(times), 6), np.nan)
    for name, column in table.components.items():
        if name not in COMPONENTS:
            raise unknown_name("component of odometry", name, COMPONENTS)
        values[:, COMPONENTS.index(name)] = array = column_of("odometry", name, column, len(times))
        infinite = np.flatnonzero(np.isinf(array))
        if len(infinite):
            raise InputError(f"odometry.{name}, row {infinite[0]}: is infinite; write NaN where nothing was measured")
    measured = ~np.isnan(values).all(axis=0)
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    gap = np.diff(times) > (LONGEST_HOLD * step if table.valid_s is None else table.valid_s)
    if table.hold == "next":
        edges = np.append(times, times[-1] + step)
        values[:-1][gap] = np.nan
    elif table.hold == "before":
        edges = np.insert(times, 0, times[0] - step)  # means, however long they are of
    else:
        edges, values = times, 0.5 * (values[1:] + values[:-1])
        values[gap] = np.nan
    _move_to_array(values, measured, table.lever_arm_m)
    return Motion(edges, values, measured)


def _move_to_array(velocity: Floats, measured: NDArray[np.bool_], lever_arm_m: Sequence[float]) -> None:
    """Make velocities (N, 6) of the point that was measured those of the array: v + omega x r.

    Yaw, pitch and roll rates stand for the body's angular rates, which holds for small pitch and roll. A velocity that
    the rotation adds to becomes known only if the lever arm and the rate are.
    """
    x, y, z = lever_arm_m
    if x == y == z == 0.0:
        return
    yaw, pitch, roll = (np.nan_to_num(velocity[:, 3 + i]) for i in range(3))
    for i, added in enumerate((pitch * z - yaw * y, yaw * x - roll * z, roll * y - pitch * x)):
        if not measured[i] and added.any():
            velocity[:, i], measured[i] = 0.0, True  # the measured point does not move that way; the array does
        velocity[:, i] += added


def mean_velocities(motion: Motion, times: Floats, start_pose: Floats) -> Floats:
    """Return mean body velocities (T, 6), in m/s and rad/s, between `times` (T,) in s, row 0 zero.

    NaN where less than half was measured. The held velocities are integrated exactly (`frames.integrate_pose` on every
    piece) from the attitude of start_pose (6,). Driving ahead in a turn moves the vehicle to the side of its mean
    heading: a velocity that the odometry does not have is measured where its motion amounts to one.
    """
    out, measured = np.zeros((len(times), 6)), motion.measured
    if np.array_equal(motion.edges_s[1:], times):  # already means between these very times
        out[1:] = motion.velocity[1:]
        out[:, ~measured] = np.nan
        return out
    poses, known = integrate(motion, times, start_pose)
    out[1:] = mean_velocity(poses[:-1], poses[1:], np.diff(times))
    absent = np.flatnonzero(~measured)
    amounts = np.abs(out[:, absent]).max(axis=0) > STILL
    known[:, absent] = np.all(known[:, measured], axis=1, keepdims=True)
    out[1:][~known] = np.nan
    out[:, absent[~amounts]] = np.nan
    return out


def to_fixes(motion: Motion, times: Floats, fixes_s: Floats, start_pose: Floats) -> Floats:
    """Return mean body velocities (R, 6), in m/s and rad/s, from the last of `times` (T,) before each of `fixes_s` (R,)
    to the fix; NaN where less than half was measured, and for fixes outside of `times`; zero at a snapshot.
    """
    out = np.full((len(fixes_s), 6), np.nan)
    inside = (fixes_s >= times[0]) & (fixes_s <= times[-1])
    knots, at = np.unique(np.concatenate([times, fixes_s[inside]]), return_inverse=True)
    if len(knots) < 2:
        return out
    poses, measured = integrate(motion, knots, start_pose)
    fix, before = at[len(times) :], at[np.searchsorted(times, fixes_s[inside], side="right") - 1]
    unmeasured = np.append(0, np.cumsum(~measured[:, motion.measured].all(axis=1)))
    lasts = knots[fix] - knots[before]
    known = unmeasured[fix] == unmeasured[before]
    velocity = mean_velocity(poses[before], poses[fix], np.where(lasts > 0.0, lasts, 1.0))
    out[inside] = np.where(known[:, None], velocity, np.nan)
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
