"""Compiled pieces of one measurement: power, geometry, detection probability, deviations, errors that persist.

Source: sector antenna, 3GPP TR 36.814, Table A.2.1.1-2; element of the array, TR 38.901, Table 7.3-1; own derivation,
docs/explanation/front-end.md, "Statistical front end", and docs/explanation/persisting-errors.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import Array, LinkTable, Model, PathColumns, Spread
from cellslam.sim.lte.steering_kernel import write_phasors

COMPONENT = (0, 1, 2, 1, 2, 0, 1, 2)  # that each field of direction, then of place, is an error of


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
def array_gain(elevation: float) -> float:
    """Return the mean power gain of the array's ports: TR 38.901 Table 7.3-1, 16 columns, two slants."""
    return float(10.0 ** (-0.1 * (2.16 + min(12.0 * (math.degrees(elevation) / 65.0) ** 2, 30.0))))


@njit(cache=True)
def path_power(gain: Array, slant: Array) -> float:
    """Return the power of both received polarisations for unit power sent with `slant`; gain[rx, tx]."""
    h = gain[0, 0] * slant[0] + gain[0, 1] * slant[1]
    v = gain[1, 0] * slant[0] + gain[1, 1] * slant[1]
    return float(h.real**2 + h.imag**2 + v.real**2 + v.imag**2)


@part
def link_powers(
    paths: PathColumns, base: int, geo: Array, links: LinkTable, sector: Array, eirp: float, power: Array,
    cell_power: Array,
) -> None:  # fmt: skip
    """Write `power` (L, W) per link and path in mW, and `cell_power` (C,), the mean over a cell's ports of its total.

    `base`: first row of `paths.rows` of this snapshot; `geo` (S, W, 3) as `body_geometry` writes it; `sector` (P, C):
    relative power gain of each cell's antenna towards a path.
    """
    for cell in range(len(cell_power)):
        cell_power[cell] = 0.0
    for link in range(len(links.site)):
        site, cell = links.site[link], links.cell[link]
        first = paths.rows[base + site]
        for i in range(paths.rows[base + site + 1] - first):
            p = first + i
            received = path_power(paths.gain[p], links.slant[link]) * sector[p, cell] * array_gain(geo[site, i, 2])
            power[link, i] = eirp * received
            cell_power[cell] += power[link, i] / links.cell_ports[cell]


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
    at = (gamma_db - k.TABLE_START_DB) / k.TABLE_STEP_DB
    i, table = int(at), model.detection.isolated
    if at < 0.0:
        return 0.0
    if i >= len(table) - 1:
        return 1.0
    return float(table[i] + (at - i) * (table[i + 1] - table[i]))


@part
def write_std(gamma: float, elevation: float, floor: Spread, model: Model, out: Array) -> None:
    """Write the deviations (3,) of a measurement at effective integrated SNR `gamma`: the bound and a floor."""
    root, scale, bound = 1.0 / math.sqrt(2.0 * gamma), model.accuracy.scale, model.accuracy.bound
    cosine = max(math.cos(elevation), 0.05)
    growth = 1.0 + k.ELEVATION_GROWTH * elevation**2
    out[0] = scale * math.hypot(bound.distance_m * root, floor.distance_m)
    out[1] = scale * math.hypot(bound.azimuth_rad * root / cosine**k.AZIMUTH_EXPONENT, floor.azimuth_rad)
    out[2] = scale * math.hypot(bound.elevation_rad * root * growth, floor.elevation_rad)


@part
def write_claims(row: Array, gamma: float, elevation: float, model: Model) -> None:
    """Write true and claimed deviations of a measurement at effective integrated SNR `gamma`."""
    write_std(gamma, elevation, model.accuracy.floor, model, row[k.TRUE_STD : k.TRUE_STD + 3])
    # A claim of exactness would break estimators: one centimetre and 1e-4 rad are the least that is claimed.
    row[k.CLAIMED_STD] = max(row[k.TRUE_STD], 1e-2)
    row[k.CLAIMED_STD + 1] = max(row[k.TRUE_STD + 1], 1e-4)
    row[k.CLAIMED_STD + 2] = max(row[k.TRUE_STD + 2], 1e-4)


@part
def fold(row: Array) -> None:
    """Bring elevation into [-pi/2, pi/2] (over the pole turns the azimuth round) and azimuth into (-pi, pi]."""
    elevation = wrap(row[k.ELEVATION])
    if elevation > 0.5 * math.pi:
        elevation, row[k.AZIMUTH] = math.pi - elevation, row[k.AZIMUTH] + math.pi
    elif elevation < -0.5 * math.pi:
        elevation, row[k.AZIMUTH] = -math.pi - elevation, row[k.AZIMUTH] + math.pi
    row[k.ELEVATION] = elevation
    row[k.AZIMUTH] = wrap(row[k.AZIMUTH])


@part
def clutter_row(row: Array, distance: float, azimuth: float, elevation: float, gamma: float, model: Model) -> None:
    """Fill one clutter measurement."""
    row[k.DISTANCE], row[k.AZIMUTH], row[k.ELEVATION] = distance, azimuth, elevation
    fold(row)
    row[k.SNR_DB] = 10.0 * math.log10(gamma / model.budget.samples)
    write_claims(row, gamma, row[k.ELEVATION], model)
    for i in range(3):
        row[k.TRUE_STD + i], row[k.MERGING_SHIFT + i] = math.nan, math.nan
    row[k.PATH] = -1.0


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
    angle, cosine, sine = np.empty(8 * count), np.empty(8 * count), np.empty(8 * count)
    for f in range(5):
        for w in range(count):
            wave = fields.direction_wave[f, w]
            angle[f * count + w] = wave[0] * ce * ca + wave[1] * ce * sa + wave[2] * se + fields.direction_phase[f, w]
    for f in range(3):
        for w in range(count):
            wave, phase = fields.place_wave[f, w], fields.place_phase[f, w] + fields.port_phase[f, w, port % 4]
            here = wave[0] * pose[0] + wave[1] * pose[1] + wave[2] * pose[2]
            angle[(5 + f) * count + w] = here + wave[3] * vt[0] + wave[4] * vt[1] + wave[5] * vt[2] + phase
    write_phasors(angle, cosine, sine)
    # A frame that has turned by small yaw, pitch, roll sees the direction turned the other way.
    tangent = se / max(ce, 0.05)
    out[0] = 0.0
    out[1] = -attitude[0] + tangent * (attitude[1] * sa + attitude[2] * ca)
    out[2] = attitude[1] * ca - attitude[2] * sa
    for f in range(8):
        std = fields.direction_std[f] if f < 5 else fields.place_std[f - 5]
        total = cosine[f * count : (f + 1) * count].sum()
        out[COMPONENT[f]] += std * math.sqrt(2.0 / count) * total
