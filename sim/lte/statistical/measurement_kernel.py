"""Compiled pieces of one measurement: geometry, detection probability, deviations, range of angles.

Source: own derivation, docs/explanation/front-end.md, "Statistical front end".
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.single_path_bound import AZIMUTH_EXPONENT, ELEVATION_GROWTH
from cellslam.sim.lte.statistical.detector_layout import (
    AZIMUTH,
    CLAIMED_STD,
    DISTANCE,
    ELEVATION,
    MERGING_SHIFT,
    PATH,
    SNR_DB,
    TABLE_START_DB,
    TABLE_STEP_DB,
    TRUE_STD,
    Array,
    Model,
)


@njit(cache=True)
def body_geometry(pose: Array, vt: Array, out: Array) -> None:
    """Write distance, azimuth and elevation of `vt` in the body frame of `pose` into `out`."""
    cp, sp = math.cos(pose[3]), math.sin(pose[3])
    ct, st = math.cos(pose[4]), math.sin(pose[4])
    cr, sr = math.cos(pose[5]), math.sin(pose[5])
    dx, dy, dz = vt[0] - pose[0], vt[1] - pose[1], vt[2] - pose[2]
    x = cp * ct * dx + sp * ct * dy - st * dz
    y = (cp * st * sr - sp * cr) * dx + (sp * st * sr + cp * cr) * dy + ct * sr * dz
    z = (cp * st * cr + sp * sr) * dx + (sp * st * cr - cp * sr) * dy + ct * cr * dz
    out[0] = math.sqrt(dx * dx + dy * dy + dz * dz)
    out[1] = math.atan2(y, x)
    out[2] = math.atan2(z, math.sqrt(x * x + y * y))


@part
def detection_probability(gamma: float, overlapped: bool, model: Model) -> float:
    """Return the detection probability at integrated SNR `gamma` (leftover already applied)."""
    if gamma <= 1e-2:
        return 0.0
    gamma_db = 10.0 * math.log10(gamma)
    if overlapped:
        return 1.0 / (1.0 + math.exp(-(gamma_db - model.overlap.centre_db) / model.overlap.width_db))
    at = (gamma_db - TABLE_START_DB) / TABLE_STEP_DB
    i, table = int(at), model.detection.isolated
    if at < 0.0:
        return 0.0
    if i >= len(table) - 1:
        return 1.0
    return float(table[i] + (at - i) * (table[i + 1] - table[i]))


@part
def write_std(row: Array, gamma: float, elevation: float, model: Model) -> None:
    """Write true and claimed deviations of a measurement at effective integrated SNR `gamma`."""
    root, scale = 1.0 / math.sqrt(2.0 * gamma), model.accuracy.scale
    bound, floor = model.accuracy.bound, model.accuracy.floor
    cosine = max(math.cos(elevation), 0.05)
    growth = 1.0 + ELEVATION_GROWTH * elevation**2
    row[TRUE_STD] = scale * math.hypot(bound.distance_m * root, floor.distance_m)
    row[TRUE_STD + 1] = scale * math.hypot(bound.azimuth_rad * root / cosine**AZIMUTH_EXPONENT, floor.azimuth_rad)
    row[TRUE_STD + 2] = scale * math.hypot(bound.elevation_rad * root * growth, floor.elevation_rad)
    # A claim of exactness would break estimators: one centimetre and 1e-4 rad are the least that is claimed.
    row[CLAIMED_STD] = max(row[TRUE_STD], 1e-2)
    row[CLAIMED_STD + 1] = max(row[TRUE_STD + 1], 1e-4)
    row[CLAIMED_STD + 2] = max(row[TRUE_STD + 2], 1e-4)


@part
def write_white_std(gamma: float, elevation: float, model: Model, out: Array) -> None:
    """Write the deviations (3,) of what is redrawn for every measurement at effective integrated SNR `gamma`."""
    root, scale = 1.0 / math.sqrt(2.0 * gamma), model.accuracy.scale
    bound, white = model.accuracy.bound, model.accuracy.white
    cosine = max(math.cos(elevation), 0.05)
    growth = 1.0 + ELEVATION_GROWTH * elevation**2
    out[0] = scale * math.hypot(bound.distance_m * root, white.distance_m)
    out[1] = scale * math.hypot(bound.azimuth_rad * root / cosine**AZIMUTH_EXPONENT, white.azimuth_rad)
    out[2] = scale * math.hypot(bound.elevation_rad * root * growth, white.elevation_rad)


@part
def fold(row: Array) -> None:
    """Bring elevation into [-pi/2, pi/2] (over the pole turns the azimuth round) and azimuth into (-pi,
    pi].
    """
    elevation = wrap(row[ELEVATION])
    if elevation > 0.5 * math.pi:
        elevation, row[AZIMUTH] = math.pi - elevation, row[AZIMUTH] + math.pi
    elif elevation < -0.5 * math.pi:
        elevation, row[AZIMUTH] = -math.pi - elevation, row[AZIMUTH] + math.pi
    row[ELEVATION] = elevation
    row[AZIMUTH] = wrap(row[AZIMUTH])


@part
def clutter_row(row: Array, distance: float, azimuth: float, elevation: float, gamma: float, model: Model) -> None:
    """Fill one clutter measurement."""
    row[DISTANCE], row[AZIMUTH], row[ELEVATION] = distance, azimuth, elevation
    fold(row)
    row[SNR_DB] = 10.0 * math.log10(gamma / model.budget.samples)
    write_std(row, gamma, row[ELEVATION], model)
    for i in range(3):
        row[TRUE_STD + i], row[MERGING_SHIFT + i] = math.nan, math.nan
    row[PATH] = -1.0
