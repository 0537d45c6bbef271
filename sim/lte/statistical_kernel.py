"""Compiled kernel of the statistical detector: traced paths in, measurements out, snapshot by snapshot.

Everything runs serially and draws from the three generators in a fixed order (per link: one uniform and
three normals for every path, then the clutter), so one block or many give the same numbers. Powers are in
milliwatt per resource element, ratios linear, angles in radians, distances in metres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]
# Output columns.
SNAPSHOT, LINK, DISTANCE, AZIMUTH, ELEVATION, SNR_DB = 0, 1, 2, 3, 4, 5
CLAIMED_STD, TRUE_STD, PATH, COLUMNS = 6, 9, 12, 13
# More clutter of one kind from one cause than this is not drawn: far beyond what the config's ranges reach.
MOST_CLUTTER = 256
NEIGHBOUR_M = 40.0
ISOLATED_LEFTOVER = 0.9
GHOST_REACH_M = 10.0
# Probability table over Gamma' in dB.
TABLE_START_DB, TABLE_STEP_DB = -20.0, 0.05


class LinkTable(NamedTuple):
    """Links (L,) sorted as in the recording, and the cells (C,) that they belong to; `slant` (L, 2) is (H,
    V).
    """

    site: Array
    cell: Array
    slant: Array
    cell_site: Array
    cell_azimuth: Array
    cell_tilt: Array
    cell_ports: Array


class Model(NamedTuple):
    """The radio configuration in linear units; scales as in `BoundScales`, floors are standard deviations."""

    eirp: float
    noise: float
    load: float
    evm_power: float
    snr_cap: float
    samples: float
    distance_scale: float
    azimuth_scale: float
    elevation_scale: float
    distance_floor: float
    azimuth_floor: float
    elevation_floor: float
    noise_scale: float
    detection_scale: float
    perfect: bool
    window_min: float
    window_max: float
    noise_clutter: float
    ghosts: float
    diffuse: float
    ghost_rule: float


@njit(cache=True)
def _wrap(angle: float) -> float:
    """Wrap to (-pi, pi]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))


@njit(cache=True)
def sector_gain(azimuth: float, elevation: float, cell_azimuth: float, cell_tilt: float) -> float:
    """Return the relative power gain of a sector antenna (TR 36.814, Table A.2.1.1-2); tilt is downwards."""
    off = math.degrees(_wrap(azimuth - cell_azimuth))
    down = math.degrees(-elevation - cell_tilt)
    horizontal = min(12.0 * (off / 70.0) ** 2, 25.0)
    vertical = min(12.0 * (down / 10.0) ** 2, 20.0)
    return 10.0 ** (-0.1 * min(horizontal + vertical, 25.0))


@njit(cache=True)
def array_gain(elevation: float) -> float:
    """Return the power gain of a field, mean over the array's ports: TR 38.901 elements, 16 columns, two
    slants.
    """
    return 10.0 ** (-0.1 * (2.16 + min(12.0 * (math.degrees(elevation) / 65.0) ** 2, 30.0)))


@njit(cache=True)
def probability(gamma: float, overlapped: bool, table: Array) -> float:
    """Return the detection probability at integrated SNR `gamma` (leftover already applied)."""
    if gamma <= 1e-2:
        return 0.0
    gamma_db = 10.0 * math.log10(gamma)
    if overlapped:
        return 1.0 / (1.0 + math.exp(-(gamma_db - 14.0) / 1.6))
    at = (gamma_db - TABLE_START_DB) / TABLE_STEP_DB
    i = int(at)
    if at < 0.0:
        return 0.0
    if i >= len(table) - 1:
        return 1.0
    return table[i] + (at - i) * (table[i + 1] - table[i])


@njit(cache=True)
def _body_geometry(pose: Array, vt: Array, out: Array) -> None:
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


@njit(cache=True)
def path_power(gain: Array, slant: Array) -> float:
    """Return the power of both received polarisations for unit power sent with `slant`; gain[rx, tx]."""
    h = gain[0, 0] * slant[0] + gain[0, 1] * slant[1]
    v = gain[1, 0] * slant[0] + gain[1, 1] * slant[1]
    return h.real**2 + h.imag**2 + v.real**2 + v.imag**2


@njit(cache=True)
def captured(a: Array, b: Array, model: Model) -> float:
    """Return the share of path a's energy inside the tangent space of path b (distance, azimuth, elevation
    each).

    Gaussian ambiguity exp(-s^2) with the bound's widths, value and first derivatives: exp(-s^2) (1 + s^2).
    """
    cosine = math.cos(0.5 * (a[2] + b[2])) ** 0.9
    u = (a[0] - b[0]) / model.distance_scale
    v = _wrap(a[1] - b[1]) * cosine / model.azimuth_scale
    w = (a[2] - b[2]) / model.elevation_scale
    s = u * u + v * v + w * w
    return math.exp(-s) * (1.0 + s)


@njit(cache=True)
def _write_std(row: Array, gamma: float, elevation: float, model: Model) -> None:
    """Write true and claimed deviations of a measurement at effective integrated SNR `gamma`."""
    root = 1.0 / math.sqrt(2.0 * gamma)
    cosine = max(math.cos(elevation), 0.05)
    sd = math.hypot(model.distance_scale * root, model.distance_floor)
    sa = math.hypot(model.azimuth_scale * root / cosine**0.9, model.azimuth_floor)
    se = math.hypot(model.elevation_scale * root * (1.0 + 0.43 * elevation**2), model.elevation_floor)
    row[TRUE_STD] = model.noise_scale * sd
    row[TRUE_STD + 1] = model.noise_scale * sa
    row[TRUE_STD + 2] = model.noise_scale * se
    # A claim of exactness would break estimators: one centimetre and 1e-4 rad are the least that is claimed.
    row[CLAIMED_STD] = max(row[TRUE_STD], 1e-2)
    row[CLAIMED_STD + 1] = max(row[TRUE_STD + 1], 1e-4)
    row[CLAIMED_STD + 2] = max(row[TRUE_STD + 2], 1e-4)


@njit(cache=True)
def _fold(row: Array) -> None:
    """Bring elevation into [-pi/2, pi/2] (over the pole turns the azimuth round) and azimuth into (-pi,
    pi].
    """
    elevation = _wrap(row[ELEVATION])
    if elevation > 0.5 * math.pi:
        elevation, row[AZIMUTH] = math.pi - elevation, row[AZIMUTH] + math.pi
    elif elevation < -0.5 * math.pi:
        elevation, row[AZIMUTH] = -math.pi - elevation, row[AZIMUTH] + math.pi
    row[ELEVATION] = elevation
    row[AZIMUTH] = _wrap(row[AZIMUTH])


@njit(cache=True)
def _clutter_row(
    row: Array, distance: float, azimuth: float, elevation: float, gamma: float, model: Model
) -> None:
    """Fill one clutter measurement."""
    row[DISTANCE], row[AZIMUTH], row[ELEVATION] = distance, azimuth, elevation
    _fold(row)
    row[SNR_DB] = 10.0 * math.log10(gamma / model.samples)
    _write_std(row, gamma, row[ELEVATION], model)
    row[TRUE_STD : TRUE_STD + 3] = math.nan
    row[PATH] = -1.0


@njit(cache=True)
def _detect_paths(
    n: int,
    geo: Array,
    gamma: Array,
    model: Model,
    table: Array,
    noise: Any,
    detection: Any,
    work: Array,
    out: Array,
) -> int:
    """Draw the measurements of one link's true paths into `out`; return how many.

    `work` (W, 8): order, leftover, nearest stronger path, detected, shifts (3), power added.
    """
    for i in range(n):
        j = i
        while j > 0 and gamma[int(work[j - 1, 0])] < gamma[i]:
            work[j, 0] = work[j - 1, 0]
            j -= 1
        work[j, 0] = i
    for rank in range(n):
        p = int(work[rank, 0])
        leftover, most, near, ghost = 1.0, 0.0, -1, False
        for other in range(rank):
            q = int(work[other, 0])
            apart = abs(geo[p, 0] - geo[q, 0])
            ghost = ghost or (apart < GHOST_REACH_M and gamma[p] < gamma[q] * model.ghost_rule)
            if apart < NEIGHBOUR_M:
                share = captured(geo[p], geo[q], model)
                leftover *= 1.0 - share
                if share > most:
                    most, near = share, q
        work[p, 1], work[p, 2], work[p, 3] = leftover, near, 0.0 if ghost else 1.0
    for i in range(n):
        work[i, 4:8] = 0.0
        inside = model.window_min <= geo[i, 0] <= model.window_max
        chance = (
            probability(gamma[i] * work[i, 1], work[i, 1] <= ISOLATED_LEFTOVER, table) * model.detection_scale
        )
        found = detection.random() < chance and inside and work[i, 3] > 0.0
        work[i, 3] = 1.0 if found or model.perfect else 0.0
        if model.perfect:
            work[i, 1] = 1.0
    for i in range(n):
        q = int(work[i, 2])
        if work[i, 3] == 0.0 and q >= 0:
            # What is not resolved is attributed to the stronger neighbour, and pulls it.
            merged = 1.0 - work[i, 1]
            pull = merged * gamma[i] / (gamma[i] + gamma[q])
            work[q, 4] += pull * (geo[i, 0] - geo[q, 0])
            work[q, 5] += pull * _wrap(geo[i, 1] - geo[q, 1])
            work[q, 6] += pull * (geo[i, 2] - geo[q, 2])
            work[q, 7] += merged * gamma[i]
    count = 0
    for i in range(n):
        e_d, e_a, e_e = noise.standard_normal(), noise.standard_normal(), noise.standard_normal()
        if work[i, 3] == 0.0:
            continue
        row = out[count]
        effective = max(gamma[i] * work[i, 1], 1e-2)
        _write_std(row, effective, geo[i, 2], model)
        row[DISTANCE] = geo[i, 0] + work[i, 4] * model.noise_scale + row[TRUE_STD] * e_d
        row[AZIMUTH] = geo[i, 1] + work[i, 5] * model.noise_scale + row[TRUE_STD + 1] * e_a
        row[ELEVATION] = geo[i, 2] + work[i, 6] * model.noise_scale + row[TRUE_STD + 2] * e_e
        _fold(row)
        row[SNR_DB] = 10.0 * math.log10(min((gamma[i] + work[i, 7]) / model.samples, model.snr_cap))
        row[PATH] = i
        count += 1
    return count


@njit(cache=True)
def _ghost_clutter(geo: Array, gamma: float, model: Model, table: Array, clutter: Any, out: Array) -> int:
    """Draw ghosts that array calibration error makes of one strong path; the 25 dB rule drops the weaker
    ones.
    """
    count = 0
    for _ in range(min(clutter.poisson(model.ghosts), MOST_CLUTTER)):
        level = 10.0 ** (0.1 * (-30.0 + 4.0 * clutter.standard_normal()))
        distance = geo[0] + 0.75 * clutter.standard_normal()
        azimuth = geo[1] + math.radians(40.0) * clutter.standard_normal()
        elevation = geo[2] + math.radians(15.0) * clutter.standard_normal()
        accepted = clutter.random() < probability(gamma * level, False, table) * model.detection_scale
        if accepted and level >= model.ghost_rule:
            _clutter_row(out[count], distance, azimuth, elevation, gamma * level, model)
            count += 1
    return count


@njit(cache=True)
def _diffuse_clutter(geo: Array, gamma: float, model: Model, table: Array, clutter: Any, out: Array) -> int:
    """Draw components of the diffuse cluster behind one path: 5-110 m later, median 40 m; -14 to -31 dB."""
    count = 0
    for _ in range(min(clutter.poisson(model.diffuse), MOST_CLUTTER)):
        level = 10.0 ** (-0.1 * (14.0 + 17.0 * clutter.random()))
        later = 5.0 + 105.0 * clutter.random() ** 1.585
        azimuth = geo[1] + math.radians(12.0) * clutter.standard_normal()
        elevation = geo[2] + math.radians(6.0) * clutter.standard_normal()
        accepted = clutter.random() < probability(gamma * level, False, table) * model.detection_scale
        if accepted and (later >= GHOST_REACH_M or level >= model.ghost_rule):
            _clutter_row(out[count], geo[0] + later, azimuth, elevation, gamma * level, model)
            count += 1
    return count


@njit(cache=True)
def _noise_clutter(model: Model, table: Array, threshold: float, clutter: Any, out: Array) -> int:
    """Draw noise peaks over the threshold: uniform in the delay window and in azimuth."""
    count = min(clutter.poisson(model.noise_clutter), MOST_CLUTTER)
    for i in range(count):
        distance = model.window_min + (model.window_max - model.window_min) * clutter.random()
        azimuth = math.pi * (2.0 * clutter.random() - 1.0)
        elevation = math.radians(-30.0 + 90.0 * clutter.random())
        # The excess of a chi-square tail over its threshold is exponential; T = 2 + 0.93 Gamma' on average.
        excess = -math.log(1.0 - clutter.random())
        _clutter_row(out[i], distance, azimuth, elevation, (threshold + excess - 2.0) / 0.93, model)
    return count


@njit(cache=True)
def _emit(
    snapshot: int, link: int, count: int, offset: float, first: int, buffer: Array, order: Array, out: Array
) -> None:
    """Copy one link's rows, sorted by distance, behind the rows already in `out`; the clock offset is added
    here.
    """
    for i in range(count):
        j = i
        while j > 0 and buffer[order[j - 1], DISTANCE] > buffer[i, DISTANCE]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    for i in range(count):
        row = out[i]
        row[:] = buffer[order[i]]
        row[SNAPSHOT], row[LINK] = snapshot, link
        row[DISTANCE] += offset
        if row[PATH] >= 0.0:
            row[PATH] += first


@njit(cache=True)
def _powers(
    rows: Array,
    base: int,
    gain: Array,
    departure: Array,
    geo: Array,
    links: LinkTable,
    eirp: float,
    power: Array,
    cell_power: Array,
) -> None:
    """Fill `power` (L, W) per link and path, and `cell_power` (C,): the mean over a cell's ports of its
    total.
    """
    cell_power[:] = 0.0
    for link in range(len(links.site)):
        site, cell = links.site[link], links.cell[link]
        first = rows[base + site]
        for i in range(rows[base + site + 1] - first):
            p = first + i
            sector = sector_gain(
                departure[p, 0], departure[p, 1], links.cell_azimuth[cell], links.cell_tilt[cell]
            )
            received = path_power(gain[p], links.slant[link]) * sector * array_gain(geo[site, i, 2])
            power[link, i] = eirp * received
            cell_power[cell] += power[link, i] / links.cell_ports[cell]


@njit(cache=True)
def measure_block(
    first_snapshot: int,
    poses: Array,
    rows: Array,
    vt: Array,
    gain: Array,
    departure: Array,
    offsets: Array,
    links: LinkTable,
    model: Model,
    table: Array,
    threshold: float,
    noise: Any,
    detection: Any,
    clutter: Any,
) -> Array:
    """Return the measurements (M, COLUMNS) of `poses` (T, 6), numbered from `first_snapshot`.

    `rows` (T S + 1,): paths of (snapshot, site) are rows[t S + s] up to rows[t S + s + 1] of vt (P, 3), gain
    (P, 2, 2) as [rx, tx] in (H, V), and departure (P, 2) azimuth, elevation in the world; `offsets` (S,).
    """
    sites, count_links = len(offsets), len(links.site)
    widest = 1
    for k in range(len(rows) - 1):
        widest = max(widest, rows[k + 1] - rows[k])
    geo = np.empty((sites, widest, 3))
    power = np.empty((count_links, widest))
    cell_power = np.empty(len(links.cell_site))
    gamma, work = np.empty(widest), np.empty((widest, 8))
    most = widest + (2 * widest + 1) * MOST_CLUTTER
    buffer, order = np.empty((most, COLUMNS)), np.empty(most, np.int64)
    out, used = np.empty((max(256, 4 * len(vt)), COLUMNS)), 0
    for t in range(len(poses)):
        base = t * sites
        for s in range(sites):
            for i in range(rows[base + s + 1] - rows[base + s]):
                _body_geometry(poses[t], vt[rows[base + s] + i], geo[s, i])
        _powers(rows, base, gain, departure, geo, links, model.eirp, power, cell_power)
        total = cell_power.sum()
        for link in range(count_links):
            site, cell = links.site[link], links.cell[link]
            first = rows[base + site]
            n = rows[base + site + 1] - first
            own = power[link, :n].sum()
            sigma2 = model.noise + model.load * (total - cell_power[cell]) + model.evm_power * own
            for i in range(n):
                gamma[i] = model.samples * min(power[link, i] / sigma2, model.snr_cap)
            count = _detect_paths(n, geo[site], gamma, model, table, noise, detection, work, buffer)
            for i in range(n):
                count += _ghost_clutter(geo[site, i], gamma[i], model, table, clutter, buffer[count:])
                count += _diffuse_clutter(geo[site, i], gamma[i], model, table, clutter, buffer[count:])
            count += _noise_clutter(model, table, threshold, clutter, buffer[count:])
            if used + count > len(out):
                larger = np.empty((2 * (used + count), COLUMNS))
                larger[:used] = out[:used]
                out = larger
            _emit(first_snapshot + t, link, count, offsets[site], first, buffer, order, out[used:])
            used += count
    return out[:used].copy()
