"""Errors of measurements that persist: deviations by place and by direction, and over which distance they change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.recordings.fitting.fit_motion import Apart, apart, offset_known
from cellslam.recordings.fitting.fit_tracks import QUANTITIES, Tracks
from cellslam.sim.recording import Floats, Recording

NAMES = {"distance_m": "m", "azimuth_rad": "azimuth_deg", "elevation_rad": "elevation_deg"}
LONG_LAGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
LEAST_SNAPSHOTS = 30
# How far the vehicle may have come, in shares of the range, for a prediction to be one.
FAR_KNOWN, FAR_UNKNOWN = 0.3, 0.03


@dataclass(frozen=True)
class Persisting:
    """Deviations of errors that change with the place, over `scale_m`, and with the direction; empty: not known."""

    place: dict[str, float]
    direction: dict[str, float]
    scale_m: float


def in_unit(name: str, value: float) -> float:
    """Return metres as they are, radians in degrees."""
    return value if name == "distance_m" else float(np.degrees(value))


def persisting(r: Recording, tracks: Tracks, white: dict[str, float]) -> Persisting:
    """Return the errors beyond the white ones: how paths depart from their predictions over more and more snapshots,
    the odometry's error removed.

    The variance of half a difference is white + place^2 (1 - rho(travelled)) + direction^2 (1 - rho(change of
    direction)), rho = exp(-x^2 / (2 scale^2)), as `slam.measurements` has it; the scale of the place is that which fits
    best.
    """
    nothing = Persisting({}, {}, 0.0)
    if not all(NAMES[name] in white for name in QUANTITIES[:2]):
        return nothing
    ratio = deviations(white)
    range_m, known = reach(r, tracks)
    parts: list[Apart] = []
    for lag in LONG_LAGS:
        part = apart(r, tracks, lag, ratio)
        clear = part.moved_m < (FAR_KNOWN if known else FAR_UNKNOWN) * range_m
        if len(part.motion) < LEAST_SNAPSHOTS or part.moved_m == 0.0 or (parts and not clear):
            break
        parts.append(part)
    if len(parts) < 3:
        return nothing
    travelled = np.array([part.moved_m for part in parts])
    change = np.degrees([part.turned_rad for part in parts]) + np.degrees(travelled / range_m)
    grid = np.geomspace(0.5 * travelled[0], travelled[-1], 24)
    fits = [_components(parts, white, travelled, change, float(scale)) for scale in grid]
    _, place, direction = min(fits, key=lambda fit: fit[0])
    return Persisting(place, direction, float(grid[int(np.argmin([fit[0] for fit in fits]))]))


def deviations(white: dict[str, float]) -> Floats:
    """Return the white deviations of distance and azimuth (2,), in m and rad, never zero."""
    return np.maximum([white["m"], np.radians(white["azimuth_deg"])], 1e-6)


def _components(
    parts: list[Apart], white: dict[str, float], travelled: Floats, change_deg: Floats, scale_m: float
) -> tuple[float, dict[str, float], dict[str, float]]:
    """Return the misfit of a scale of the place, and the deviations of place and direction that fit best with it."""
    from scipy.optimize import nnls

    from cellslam.slam.measurements.measurement_options import MeasurementOptions

    scale_deg = MeasurementOptions().calibration_scale_deg
    misfit, place, direction = 0.0, {}, {}
    for i, name in enumerate(QUANTITIES):
        key = NAMES[name]
        variance = np.array([in_unit(name, _spread(part.left[:, i])) ** 2 for part in parts])
        if key not in white or not (variance > 0.0).all():
            continue
        columns = [-np.expm1(-0.5 * (travelled / scale_m) ** 2), -np.expm1(-0.5 * (change_deg / scale_deg) ** 2)]
        target = np.maximum(variance - white[key] ** 2, 0.0) / variance
        share, rest = nnls(np.column_stack(columns) / variance[:, None], target)
        misfit += rest**2
        place[key], direction[key] = (float(np.sqrt(s)) for s in share)
    return misfit, place, direction


def _spread(differences: Floats) -> float:
    """Return the deviation of one error of which these are differences of two, by the median."""
    known = differences[np.isfinite(differences)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) / np.sqrt(2.0) if len(known) else 0.0


def reach(r: Recording, tracks: Tracks) -> tuple[float, bool]:
    """Return the median distance of what is tracked, and whether it is a range: measured, the clocks known."""
    rows = np.flatnonzero(tracks.track >= 0)
    offset = r.sites.clock_offset_mean_m[r.links.site[r.measurements.link[rows]]]
    distance = r.measurements.distance_m[rows] - offset
    if np.isnan(distance).all():
        return 1.0, False
    return max(float(np.nanmedian(distance)), 1.0), bool(offset_known(r, rows).all())
