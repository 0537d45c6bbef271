"""The measurements of a snapshot with the variances that association, updates and births take.

Sources: paper, eq. 34, corrected; Priestley, "Spectral analysis and time series", 1981, section 5.3: the variance of
the mean of a correlated sequence, of which `repeats` is the sum of correlations: how many independent draws the
sequence is worth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.described import Described
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.measurements.fusion import FusedMeasurements
from cellslam.slam.measurements.measurement_options import MeasurementOptions

# Widths in distance (m), azimuth and elevation (rad) over which clutter lies about paths: what a missing component
# takes off its density.
CLUTTER_WIDTH = (20.0, 0.3, 0.25)
MOST_MERGED = 400.0  # times that one draw of what merged paths do is repeated, at most
LEAST = 1e-12  # m^2 and rad^2: variances are no smaller
MOST_REPEATS = 1e5  # standing still, an error that persists is never redrawn: nearly no information
_LOG_WIDTH = np.log(CLUTTER_WIDTH)


@dataclass(frozen=True, repr=False)
class Readings(Described):
    """The measurements of a snapshot (m,) with their variances.

    `z` (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured. `single` (m, 3): variances of one
    measurement; `many` (m, 3): those with which an update counts for what it is worth; `fresh` (m, 3): those of a VT
    that begins (links that see the same one share its errors). `gap` (m,): what the log-density of clutter is greater
    by; `merged` (3,): variances that updates take beside `many`, for what merged paths do.
    """

    z: Floats
    single: Floats
    many: Floats
    fresh: Floats
    gap: Floats
    merged: Floats = field(default_factory=lambda: np.zeros(3))


def readings(
    measurements: FusedMeasurements, port_of: Ints, options: MeasurementOptions, turn_rad: float, moved_m: float
) -> Readings:
    """Return a snapshot's measurements with their variances; since the last one the vehicle has turned and moved so
    far.

    port_of (L,): a number for each pair of site and port.
    """
    z = np.stack([measurements.distance_m, measurements.azimuth_rad, measurements.elevation_rad], axis=1)
    persisting = Persisting(*options.persisting, options.scales)
    return Readings(z, *combine(
        z, measurements.link, port_of, measurements.white, measurements.ports, measurements.clutter_log_ratio,
        persisting, turn_rad, moved_m, _LOG_WIDTH,
    ))  # fmt: skip


def white_readings(
    measurements: FusedMeasurements, options: MeasurementOptions, turn_rad: float, moved_m: float
) -> Readings:
    """Return a snapshot's measurements for a filter that has the errors that persist as states: these are white but for
    those, and `single` has the diffuse error and the sway, too, which are not known before the update.

    A cause without a scale is white. Where paths merge, their directions err as no state does, for as long as the
    vehicle sees them so: for that a share of the roof's variance is counted, as often as one draw of it is repeated.
    """
    z = np.stack([measurements.distance_m, measurements.azimuth_rad, measurements.elevation_rad], axis=1)
    plain, diffuse, sway, merged = options.beside_states
    ports = measurements.ports[:, None]
    many = np.maximum(measurements.white + plain[0] + plain[1] / ports, LEAST)
    fresh = many + merged
    single = fresh + diffuse / ports + sway
    gap = measurements.clutter_log_ratio + np.isnan(z) @ _LOG_WIDTH
    scale, change = math.radians(options.roof_scale_deg), abs(turn_rad) + abs(moved_m) / options.typical_range_m
    often = min(repeats(scale, change), MOST_MERGED)
    return Readings(z, single, many, fresh, gap, merged * often)


def novelty(options: MeasurementOptions, turn_rad: float, moved_m: float) -> float:
    """Return how much of what a snapshot shows the last one has not shown: 1 where all errors are white.

    The variance of one measurement over that with which an update counts, as `combine` has them for a lone path, mean
    over distance, azimuth and elevation. The vehicle has turned and moved since the last snapshot.
    """
    (place, direction), white = options.persisting, np.maximum(options.noise[0], LEAST)
    of_place, of_distance, of_angles, away = options.scales.tolist()
    change = abs(turn_rad) + abs(moved_m) / away
    by_angles = repeats(of_angles, change)
    again = np.array([repeats(of_distance, change), by_angles, by_angles])
    counted = white + place * repeats(of_place, moved_m) + direction * again
    return float(((white + place + direction) / counted).sum()) / len(white)


def ports_of(site_of: Ints, port: Ints) -> Ints:
    """Return a number for each link (L,) that links of one port of a site share."""
    return np.asarray(site_of, np.int64) * 64 + np.asarray(port, np.int64)


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
