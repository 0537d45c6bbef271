"""Compiled kernel of the statistical detector: traced paths in, measurements out, snapshot by snapshot.

For path p of a link, of received power P_p, with N samples (`measure_block`, unless another function is named):

    disturbance   sigma^2 = noise + load (power of other cells) + EVM^2 sum_p P_p               `sigma2`
    SNR           rho_p = min(P_p / sigma^2, cap),   Gamma_p = N rho_p                           `gamma`
    captured      C(p, q) = exp(-s^2) (1 + s^2),   s: distance of p and q in the bound's widths  `captured`
    leftover      l_p = product over stronger q within 40 m of 1 - C(p, q)                       `_overlap`
    trailing      D_p = 1 + sum over stronger q of Gamma_q (fall over delay) (toward)            `_overlap`, `trailing`
    detection     Gamma'_p = l_p Gamma_p / D_p;   P(p is detected) = P_D(Gamma'_p)               `_draw_detections`
                  P_D: where l_p > 0.9 and D_p < 1.5, P(ncx2(dof, gain Gamma'_p) > 2 x), x the
                  threshold; else a logistic in Gamma'_p in dB                                   `detection_probability`
    merging       an undetected p moves the neighbour q that captures most of it by
                  (1 - l_p) Gamma_p / (Gamma_p + Gamma_q) of their difference                    `_merge`
    error         sd^2 = scale^2 (bound^2 / (2 l_p Gamma_p) + floor^2), per component            `write_std`

    Then clutter: Poisson numbers of noise peaks and of pieces of energy around each path (`clutter_kernel`).

Everything runs serially and draws from the three generators in a fixed order (per link: one uniform and
three normals for every path, then the clutter), so one block or many give the same numbers. Powers are in
milliwatt per resource element, ratios linear, angles in radians, distances in metres.

Source: own derivation, docs/explanation/front-end.md, "Statistical front end".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical import clutter_kernel as clutter
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical import measurement_kernel as measurement
from cellslam.sim.lte.statistical.detector_layout import Array, LinkTable, Model, PathColumns, Standing, Streams
from cellslam.sim.lte.statistical.measurement_kernel import Fields

# Columns of the work space of one link: paths by strength; then of each path the share that no stronger one's tangent
# space captures, the stronger path that captures most, its SNR as a share of that over noise alone (0: a ghost),
# whether it is detected, and by how much (3) and with what power undetected neighbours change it.
ORDER, LEFTOVER, NEAREST, CLEAR, DETECTED, SHIFT, ADDED, WIDTH = 0, 1, 2, 3, 4, 5, 8, 9
# Numbers under which a square's draws for detection are drawn of its key: kind and draw.
KIND_OF_MISS, MISS = -1, -2


@part
def captured(a: Array, b: Array, model: Model) -> float:
    """Return the share of path a's energy inside the tangent space of path b; both (distance, az, el).

    Gaussian ambiguity exp(-s^2) with the bound's widths, value and first derivatives: exp(-s^2) (1 + s^2).
    """
    cosine = math.cos(0.5 * (a[2] + b[2])) ** k.AZIMUTH_EXPONENT
    u = (a[0] - b[0]) / model.accuracy.bound.distance_m
    v = wrap(a[1] - b[1]) * cosine / model.accuracy.bound.azimuth_rad
    w = (a[2] - b[2]) / model.accuracy.bound.elevation_rad
    s = u * u + v * v + w * w
    return float(math.exp(-s) * (1.0 + s))


@part
def _sort_by_strength(n: int, gamma: Array, work: Array) -> None:
    """Write the order of n paths into `work`, the strongest first."""
    for i in range(n):
        j = i
        while j > 0 and gamma[int(work[j - 1, ORDER])] < gamma[i]:
            work[j, ORDER] = work[j - 1, ORDER]
            j -= 1
        work[j, ORDER] = i


@part
def _overlap(n: int, geo: Array, gamma: Array, model: Model, work: Array) -> None:
    """Write what stronger paths leave of each path: LEFTOVER, NEAREST, and CLEAR."""
    for rank in range(n):
        p = int(work[rank, ORDER])
        leftover, most, near, ghost, disturbance = 1.0, 0.0, -1, False, 1.0
        for other in range(rank):
            q = int(work[other, ORDER])
            apart = abs(geo[p, 0] - geo[q, 0])
            if gamma[p] < k.DIFFUSE_SHARE * gamma[q]:
                disturbance += gamma[q] * clutter.trailing(geo[p], geo[q], model)
            ghost = ghost or (apart < k.GHOST_REACH_M and gamma[p] < gamma[q] * model.overlap.ghost_share)
            if apart < k.NEIGHBOUR_M:
                share = captured(geo[p], geo[q], model)
                leftover *= 1.0 - share
                if share > most:
                    most, near = share, q
        work[p, LEFTOVER], work[p, NEAREST], work[p, CLEAR] = leftover, near, 0.0 if ghost else 1.0 / disturbance


@part
def _detection_draw(pose: Array, vt: Array, port: int, standing: Standing, detection: Any) -> float:
    """Return the uniform draw that decides whether a path is detected: a new one, or that of a square of ground."""
    draw: float = detection.random()
    source = clutter.key_of_place(standing.world, vt)
    square = clutter.square_of(source, pose, standing.missed_life_m)
    kind = clutter.uniform(square, KIND_OF_MISS)
    if kind < standing.missed_life:
        return clutter.uniform(square, MISS)
    if kind < standing.missed_life + standing.missed_fading:
        return clutter.uniform(clutter.joined(clutter.square_of(source, pose, standing.fading_m), port), MISS)
    return draw


@part
def _draw_detections(
    n: int, geo: Array, gamma: Array, model: Model, pose: Array, vt: Array, port: int, detection: Any, work: Array
) -> None:
    """Draw which paths are detected, each with its detection probability, into `work`."""
    for i in range(n):
        clear = work[i, CLEAR]
        crowded = work[i, LEFTOVER] <= k.ISOLATED_LEFTOVER or clear < 1.0 / k.DISTURBED
        seen = gamma[i] * work[i, LEFTOVER] * clear
        chance = measurement.detection_probability(seen, crowded, model) * model.detection.scale
        inside = model.detection.window_min_m <= geo[i, 0] <= model.detection.window_max_m
        draw = _detection_draw(pose, vt[i], port, model.standing, detection)
        found = draw < chance and inside and clear > 0.0
        work[i, DETECTED] = 1.0 if found or model.detection.perfect else 0.0
        if model.detection.perfect:
            work[i, LEFTOVER] = 1.0


@part
def _merge(n: int, geo: Array, gamma: Array, work: Array) -> None:
    """Write how undetected paths pull their strongest neighbour, to which they are attributed: SHIFT and ADDED."""
    for i in range(n):
        for column in range(SHIFT, ADDED + 1):
            work[i, column] = 0.0
    for i in range(n):
        q = int(work[i, NEAREST])
        if work[i, DETECTED] == 0.0 and q >= 0:
            merged = 1.0 - work[i, LEFTOVER]
            pull = merged * gamma[i] / (gamma[i] + gamma[q])
            work[q, SHIFT] += pull * (geo[i, 0] - geo[q, 0])
            work[q, SHIFT + 1] += pull * wrap(geo[i, 1] - geo[q, 1])
            work[q, SHIFT + 2] += pull * (geo[i, 2] - geo[q, 2])
            work[q, ADDED] += merged * gamma[i]


@part
def _detect_paths(
    n: int, geo: Array, persisting: Array, gamma: Array, model: Model, pose: Array, vt: Array, port: int,
    streams: Streams, work: Array, out: Array,
) -> int:  # fmt: skip
    """Draw the measurements of one link's n true paths, of `persisting` errors (n, 3), into `out`; return how many."""
    _sort_by_strength(n, gamma, work)
    _overlap(n, geo, gamma, model, work)
    _draw_detections(n, geo, gamma, model, pose, vt, port, streams.detection, work)
    _merge(n, geo, gamma, work)
    count, noise = 0, streams.noise
    white = np.empty(3)
    for i in range(n):
        e_d, e_a, e_e = noise.standard_normal(), noise.standard_normal(), noise.standard_normal()
        if work[i, DETECTED] == 0.0:
            continue
        row = out[count]
        effective = max(gamma[i] * work[i, LEFTOVER], 1e-2)
        measurement.write_claims(row, effective, geo[i, 2], model)
        measurement.write_std(effective, geo[i, 2], model.accuracy.white, model, white)
        for r in range(3):
            row[k.MERGING_SHIFT + r] = work[i, SHIFT + r] * model.accuracy.scale
        row[k.DISTANCE] = geo[i, 0] + row[k.MERGING_SHIFT] + white[0] * e_d + persisting[i, 0]
        row[k.AZIMUTH] = geo[i, 1] + row[k.MERGING_SHIFT + 1] + white[1] * e_a + persisting[i, 1]
        row[k.ELEVATION] = geo[i, 2] + row[k.MERGING_SHIFT + 2] + white[2] * e_e + persisting[i, 2]
        measurement.fold(row)
        row[k.SNR_DB] = 10.0 * math.log10(min((gamma[i] + work[i, ADDED]) / model.budget.samples, model.budget.snr_cap))
        row[k.PATH] = i
        count += 1
    return count


@part
def copy_row(source: Array, target: Array) -> None:
    """Copy one measurement; a loop compiles faster than a slice."""
    for column in range(k.COLUMNS):
        target[column] = source[column]


@part
def _emit(
    snapshot: int, link: int, count: int, offset: float, first: int, buffer: Array, order: Array, out: Array
) -> None:
    """Copy one link's rows to `out`, sorted by distance, and add the clock offset."""
    for i in range(count):
        j = i
        while j > 0 and buffer[order[j - 1], k.DISTANCE] > buffer[i, k.DISTANCE]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    for i in range(count):
        row = out[i]
        copy_row(buffer[order[i]], row)
        row[k.SNAPSHOT], row[k.LINK] = snapshot, link
        row[k.DISTANCE] += offset
        if row[k.PATH] >= 0.0:
            row[k.PATH] += first


@njit(cache=True)
def measure_block(
    first_snapshot: int, poses: Array, paths: PathColumns, sector: Array, offsets: Array, links: LinkTable,
    model: Model, fields: Fields, streams: Streams,
) -> Array:  # fmt: skip
    """Return the measurements (M, k.COLUMNS) of `poses` (T, 6), numbered from `first_snapshot`; m and rad.

    `paths` (P) of all (snapshot, site); `sector` (P, C): relative power gain of each cell's antenna towards them;
    clock `offsets` (S,) in m.
    """
    rows, budget = paths.rows, model.budget
    sites, count_links = len(offsets), len(links.site)
    widest = 1
    for i in range(len(rows) - 1):
        widest = max(widest, rows[i + 1] - rows[i])
    geo, attitude = np.empty((sites, widest, 3)), np.empty(3)
    ports = links.port.max() + 1
    persisting = np.empty((sites, ports, widest, 3))  # links of one port and site share them
    power = np.empty((count_links, widest))
    cell_power = np.empty(len(links.cell_site))
    gamma, work = np.empty(widest), np.empty((widest, WIDTH))
    most = widest + (2 * widest + 1) * k.MOST_CLUTTER
    buffer, order = np.empty((most, k.COLUMNS)), np.empty(most, np.int64)
    out, used = np.empty((max(256, 4 * len(paths.vt_m)), k.COLUMNS)), 0
    for t in range(len(poses)):
        base = t * sites
        measurement.write_attitude(first_snapshot + t, fields, attitude)
        for s in range(sites):
            for i in range(rows[base + s + 1] - rows[base + s]):
                vt = paths.vt_m[rows[base + s] + i]
                measurement.body_geometry(poses[t], vt, geo[s, i])
                for port in range(ports):
                    error = persisting[s, port, i]
                    measurement.write_persisting(geo[s, i], poses[t], vt, port, attitude, fields, error)
        measurement.link_powers(paths, base, geo, links, sector, budget.eirp_mw, power, cell_power)
        total = 0.0
        for cell in range(len(cell_power)):
            total += cell_power[cell]
        for link in range(count_links):
            site, cell = links.site[link], links.cell[link]
            first = rows[base + site]
            n = rows[base + site + 1] - first
            own = 0.0
            for i in range(n):
                own += power[link, i]
            sigma2 = budget.noise_mw + budget.load * (total - cell_power[cell]) + budget.evm_power * own
            for i in range(n):
                gamma[i] = budget.samples * min(power[link, i] / sigma2, budget.snr_cap)
            count = _detect_paths(
                n, geo[site], persisting[site, links.port[link]], gamma, model, poses[t], paths.vt_m[first:],
                links.port[link], streams, work, buffer,
            )  # fmt: skip
            for i in range(n):
                count += clutter.structured_clutter(i, n, geo[site], gamma, model, streams.clutter, buffer[count:])
                if model.standing.share > 0.0:
                    count += clutter.standing_clutter(
                        i, n, geo[site], gamma, poses[t], paths.vt_m[first + i], links.port[link], model,
                        streams.clutter, buffer[count:],
                    )  # fmt: skip
            count += clutter.noise_clutter(model, streams.clutter, buffer[count:])
            if used + count > len(out):
                larger = np.empty((2 * (used + count), k.COLUMNS))
                for i in range(used):
                    copy_row(out[i], larger[i])
                out = larger
            _emit(first_snapshot + t, link, count, offsets[site], first, buffer, order, out[used:])
            used += count
    return out[:used]
