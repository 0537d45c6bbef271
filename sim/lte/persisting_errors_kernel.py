"""Compiled evaluation of the errors that persist: smooth random functions of direction, place and time.

Source: own derivation, docs/explanation/persisting-errors.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import njit
from cellslam.sim.lte.statistical.detector_layout import Array


class Fields(NamedTuple):
    """Gaussian random fields as sums of W cosines; deviations (F,) in m or rad, zero where a cause is white or off.

    `direction_wave` (F, W, 3) over unit vectors in the body frame, F = 5: array calibration in distance, azimuth,
    elevation, roof scattering in azimuth, elevation. `place_wave` (3, W, 6) over the receiver's and the VT's position:
    diffuse energy in distance, azimuth, elevation; `port_phase` (3, W, 4). `time_wave` (3, W) over snapshots: yaw,
    pitch, roll. `*_phase` (F, W).
    """

    direction_std: Array
    direction_wave: Array
    direction_phase: Array
    place_std: Array
    place_wave: Array
    place_phase: Array
    port_phase: Array
    time_std: Array
    time_wave: Array
    time_phase: Array


@njit(cache=True)
def write_attitude(snapshot: int, fields: Fields, out: Array) -> None:
    """Write the array's turn (yaw, pitch, roll) of a snapshot, common to all its paths, into `out` (3,)."""
    count = fields.time_wave.shape[1]
    for f in range(3):
        out[f] = 0.0
        if fields.time_std[f] > 0.0:
            for w in range(count):
                out[f] += math.cos(fields.time_wave[f, w] * snapshot + fields.time_phase[f, w])
            out[f] *= fields.time_std[f] * math.sqrt(2.0 / count)


@njit(cache=True)
def write_persisting(
    geo: Array, pose: Array, vt: Array, port: int, attitude: Array, fields: Fields, out: Array
) -> None:
    """Write the persisting error of distance, azimuth and elevation of a path into `out` (3,)."""
    ca, sa, ce, se = math.cos(geo[1]), math.sin(geo[1]), math.cos(geo[2]), math.sin(geo[2])
    count = fields.direction_wave.shape[1]
    root = math.sqrt(2.0 / count)
    tangent = se / max(ce, 0.05)
    # A frame that has turned by small yaw, pitch, roll sees the direction turned the other way.
    out[0] = 0.0
    out[1] = -attitude[0] + tangent * (attitude[1] * sa + attitude[2] * ca)
    out[2] = attitude[1] * ca - attitude[2] * sa
    for f in range(5):
        if fields.direction_std[f] > 0.0:
            total = 0.0
            for w in range(count):
                wave = fields.direction_wave[f, w]
                angle = wave[0] * ce * ca + wave[1] * ce * sa + wave[2] * se
                total += math.cos(angle + fields.direction_phase[f, w])
            out[f if f < 3 else f - 2] += fields.direction_std[f] * root * total
    for f in range(3):
        if fields.place_std[f] > 0.0:
            total = 0.0
            for w in range(count):
                wave = fields.place_wave[f, w]
                angle = wave[0] * pose[0] + wave[1] * pose[1] + wave[2] * pose[2]
                angle += wave[3] * vt[0] + wave[4] * vt[1] + wave[5] * vt[2]
                total += math.cos(angle + fields.place_phase[f, w] + fields.port_phase[f, w, port % 4])
            out[f] += fields.place_std[f] * root * total
