"""Compiled: the variances with which measurements associate and update.

Sources: paper, eq. 34, corrected; Priestley, "Spectral analysis and time series", 1981, section 5.3: the variance of
the mean of a correlated sequence, of which `repeats` is the sum of correlations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints

LEAST = 1e-12  # m^2 and rad^2: variances are no smaller
MOST_REPEATS = 1e5  # standing still, an error that persists is never redrawn: nearly no information


class Persisting(NamedTuple):
    """Errors that persist: variances (3,) in m^2 and rad^2 of those of place, in every port and alike in all links of
    a port that see the same path, and of those of direction, in all paths from about one direction; the scales (4,)
    over which they persist (see `MeasurementOptions.scales`)."""

    place: Floats
    direction: Floats
    scales: Floats


@part
def count_sharers(z: Floats, link: Ints, group: Ints, q: Floats) -> Floats:
    """Return for each measurement (m,) how many links of its group measured the same path, its own included.

    z (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured; q (m, 3): their variances; group (m,).
    """
    count = np.ones(len(link))
    for i in range(len(link)):
        for j in range(i):
            if group[i] != group[j] or link[i] == link[j]:
                continue
            same = True
            for c in range(3):
                gap = z[i, c] - z[j, c]
                gap = wrap(gap) if c == 1 else gap
                same = same and not gap * gap > 9.0 * (q[i, c] + q[j, c])
            if same:
                count[i] += 1.0
                count[j] += 1.0
    return count


@njit(cache=True)
def scaled(snr_db: Floats, floor: Floats, unit: Floats) -> Floats:
    """Return variances (m, 3): `floor` (3,) and what noise adds to it, `unit` (3,) at 0 dB; NaN counts as 0 dB."""
    out = np.empty((len(snr_db), 3))
    for i in range(len(snr_db)):
        share = 1.0 if math.isnan(snr_db[i]) else 10.0 ** (-0.1 * snr_db[i])
        for c in range(3):
            out[i, c] = floor[c] + unit[c] * share
    return out


@njit(cache=True)
def white_variances(
    z: Floats, white: Floats, ports: Ints, clutter_log_ratio: Floats, plain: Floats, diffuse: Floats, sway: Floats,
    merged: Floats, log_width: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Return the variances (m, 3) of single measurements, of updates and of births for a filter that has what persists
    as states, in m^2 and rad^2, and (m,) what the log-density of clutter is greater by.

    z, white, ports, clutter_log_ratio, log_width as in `combine`; plain (2, 3): variances of causes without a scale, in
    all and by port; diffuse, sway, merged (3,): variances that a single measurement has beside.
    """
    m = len(z)
    single, many, fresh, gap = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3)), clutter_log_ratio.copy()
    for i in range(m):
        for c in range(3):
            many[i, c] = max(white[i, c] + plain[0, c] + plain[1, c] / ports[i], LEAST)
            fresh[i, c] = many[i, c] + merged[c]
            single[i, c] = fresh[i, c] + diffuse[c] / ports[i] + sway[c]
            gap[i] += log_width[c] if math.isnan(z[i, c]) else 0.0
    return single, many, fresh, gap


@part
def repeats(scale: float, step: float) -> float:
    """Return how many samples `step` apart share one draw of an error with correlation exp(-x^2 / (2 scale^2)): its
    sum over all lags."""
    return min(max(math.sqrt(2.0 * math.pi) * scale / max(abs(step), 1e-12), 1.0), MOST_REPEATS)


@part
def crowd(azimuth: Floats, elevation: Floats, scale: float) -> Floats:
    """Return for each direction (m,) how many directions share its error, itself included: the sum of correlations
    exp(-angle^2 / (2 scale^2)). An elevation that is missing is taken to be alike, an azimuth not."""
    count = np.ones(len(azimuth))
    half = 0.5 / max(scale * scale, 1e-12)
    for i in range(len(azimuth)):
        for j in range(i):
            across = wrap(azimuth[i] - azimuth[j])
            up, middle = elevation[i] - elevation[j], 0.5 * (elevation[i] + elevation[j])
            if math.isnan(up):
                up, middle = 0.0, 0.0
            angle = (across * math.cos(middle)) ** 2 + up * up
            if angle * half < 8.0:
                share = math.exp(-angle * half)
                count[i] += share
                count[j] += share
    return count


@njit(cache=True)
def share_new(persisting: Persisting, white: Floats, turn: float, moved: float) -> float:
    """Return the variance of a measurement over that of an update by it, mean over three components: see `novelty`.

    white (3,): variances of what does not persist, in m^2 and rad^2; turn (rad), moved (m), as in `combine`.
    """
    place, direction, scales = persisting
    by_place, change, total = repeats(scales[0], moved), abs(turn) + abs(moved) / scales[3], 0.0
    for c in range(3):
        known = max(white[c], LEAST)
        again = repeats(scales[1] if c == 0 else scales[2], change)
        total += (known + place[c] + direction[c]) / (known + place[c] * by_place + direction[c] * again)
    return total / 3.0


@njit(cache=True)
def combine(
    z: Floats, link: Ints, port_of: Ints, white: Floats, ports: Ints, clutter_log_ratio: Floats, persisting: Persisting,
    turn: float, moved: float, log_width: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Return the variances (m, 3) of single measurements, of updates and of births, in m^2 and rad^2, and (m,) what the
    log-density of clutter is greater by.

    z (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured; link (m,), port_of (L,): a number for
    each pair of site and port; white (m, 3): variances of what does not persist; ports (m,): how many ports a
    measurement is the mean of; clutter_log_ratio (m,): see `FusedMeasurements`. The vehicle has turned (rad) and moved
    (m) since the last snapshot; log_width (3,): of clutter, in what is missing.
    """
    m = len(link)
    place, direction, scales = persisting
    single, many, fresh = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))
    gap = clutter_log_ratio.copy()
    for i in range(m):
        for c in range(3):
            single[i, c] = max(white[i, c] + place[c] / ports[i] + direction[c], LEAST)
            gap[i] += log_width[c] if math.isnan(z[i, c]) else 0.0
    port = count_sharers(z, link, port_of[link], single)
    near, wide = crowd(z[:, 1], z[:, 2], scales[2]), crowd(z[:, 1], z[:, 2], scales[1])
    port = port / ports
    by_place, change = repeats(scales[0], moved), abs(turn) + abs(moved) / scales[3]
    by_distance, by_angle = repeats(scales[1], change), repeats(scales[2], change)
    for i in range(m):
        for c in range(3):
            alike = wide[i] if c == 0 else near[i]
            again = by_distance if c == 0 else by_angle
            q = white[i, c] + place[c] * by_place * port[i] + direction[c] * again * alike
            many[i, c] = max(q, LEAST)
            fresh[i, c] = max(white[i, c] + place[c] * port[i] + direction[c] * alike, LEAST)
    return single, many, fresh, gap
