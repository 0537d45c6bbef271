"""Paths as they were read, checked against geometry and made `Paths`.

A path's delay must be that of its points, and no shorter than the straight line; its angles must point along its first
and last leg. So a zenith angle taken for an elevation, a direction that points the other way, delays counted from the
first path, or padding taken for points cannot pass where there is a line of sight, or points, to tell. Sources: those
of the formats, in `sionna` and `deepmimo`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.facets import connected
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, unit_vector, wrap_angle
from cellslam.sim.rays.paths import Floats, Ints, Paths, joined

LENGTH_SHARE = 1e-5  # of single precision; it leaves 1e-7
SAME_VT_M = 0.1


class Tolerance(NamedTuple):
    """By how much a length in m and an angle in rad may miss what geometry says: those of measured paths do."""

    length_m: float = 0.01
    angle_rad: float = float(np.radians(0.5))


EXACT = Tolerance()


@dataclass(frozen=True)
class Traced:
    """Paths with the transmitters (S, 3) and receivers (N, 3) in m that they index; carrier in Hz, if given."""

    paths: Paths
    transmitters_m: Floats
    receivers_m: Floats
    carrier_hz: float | None = None


@dataclass(frozen=True)
class Columns:
    """Paths (P,) as read: angles in rad, delays in s; `gain` (P, 2, 2) as of `Paths`; `points_m` (P, I, 3) from the
    transmitter on, NaN where there is none or it is not known; `order` (P,) interactions, 0 the line of sight.
    """

    receiver: Ints
    transmitter: Ints
    order: Ints
    delay_s: Floats
    arrival_rad: Floats
    departure_rad: Floats
    gain: NDArray[np.complex128]
    points_m: Floats


def traced(
    name: str, c: Columns, transmitters_m: Floats, receivers_m: Floats, carrier_hz: float | None, tolerance: Tolerance
) -> Traced:
    """Return checked paths; of a file called `name`, between transmitters (S, 3) and receivers (N, 3) in m.

    `facets` of a path that is no line of sight numbers its VT: paths of a transmitter whose images are within 0.1 m
    come from one. Raises InputError that says what does not fit, and what would.
    """
    length = SPEED_OF_LIGHT_MPS * c.delay_s
    sent, received = transmitters_m[c.transmitter], receivers_m[c.receiver]
    # Which paths have all their points; the line of sight has none.
    whole = (c.order == 0) | (np.isfinite(c.points_m).all(axis=2).sum(axis=1) == c.order)
    # The points next to each end, where they are known.
    first, last = received.copy(), sent.copy()
    bounces = np.flatnonzero(whole & (c.order > 0))
    first[bounces] = c.points_m[bounces, 0]
    last[bounces] = c.points_m[bounces, c.order[bounces] - 1]
    straight = np.linalg.norm(sent - received, axis=1)
    legs = np.nansum(np.linalg.norm(np.diff(c.points_m, axis=1), axis=2), axis=1)
    around = np.linalg.norm(first - sent, axis=1) + legs + np.linalg.norm(received - last, axis=1)
    around_m = np.where(c.order == 0, straight, np.where(whole, around, np.nan))
    _check_lengths(name, length, straight, around_m, tolerance.length_m)
    _check_angles(name, "arrival", c.arrival_rad, (last - received)[whole], whole, tolerance.angle_rad)
    _check_angles(name, "departure", c.departure_rad, (first - sent)[whole], whole, tolerance.angle_rad)
    vt = received + length[:, None] * unit_vector(*c.arrival_rad.T)
    facets = np.full((len(length), 2), -1, np.int64)
    facets[:, 0] = _vt_numbers(vt, c.transmitter, c.order)
    points = np.full((len(length), 2, 3), np.nan)
    count = min(c.points_m.shape[1], 2)
    points[whole, :count] = c.points_m[whole, :count]
    paths = Paths(
        receiver=c.receiver, transmitter=c.transmitter, order=c.order, facets=facets,
        edge=np.full(len(length), -1, np.int64), points_m=points, vt_position_m=vt, length_m=length,
        azimuth_rad=wrap_angle(c.arrival_rad[:, 0]), elevation_rad=c.arrival_rad[:, 1],
        departure_azimuth_rad=wrap_angle(c.departure_rad[:, 0]), departure_elevation_rad=c.departure_rad[:, 1],
        gain=c.gain,
    )  # fmt: skip
    return Traced(joined([paths]), transmitters_m, receivers_m, carrier_hz)


def _check_lengths(name: str, length: Floats, straight: Floats, around_m: Floats, tolerance_m: float) -> None:
    """Raise InputError for a delay (P,) in m that is no path `around_m` over its points, or less than the straight
    line."""
    allowed = tolerance_m + LENGTH_SHARE * length
    for wrong, there, what in (
        (length < straight - allowed, straight, "its ends are {:.3f} m apart"),
        (np.abs(around_m - length) > allowed, around_m, "its points make a path of {:.3f} m"),
    ):
        rows = np.flatnonzero(wrong)
        if len(rows):
            found = what.format(there[rows[0]])
            raise InputError(
                f"{name}: path {rows[0]} has a delay of {length[rows[0]]:.3f} m, but {found}: are delays counted from "
                "the first path? save absolute ones, in seconds"
            )


def _check_angles(
    name: str, end: str, angle: Floats, towards: Floats, known: NDArray[np.bool_], tolerance_rad: float
) -> None:
    """Raise InputError unless the angles (P, 2) of paths that are `known` point along their legs (K, 3)."""
    if not known.any():
        return
    azimuth, elevation = angle[known].T
    leg = towards / np.linalg.norm(towards, axis=1, keepdims=True)

    def off(az: Floats, el: Floats) -> Floats:
        across = np.linalg.norm(np.cross(unit_vector(az, el), leg), axis=1)
        return np.asarray(np.arctan2(across, np.einsum("pi,pi->p", unit_vector(az, el), leg)))

    error = off(azimuth, elevation)
    if error.max() < tolerance_rad:
        return
    others = {
        "they point the other way": (azimuth + np.pi, -elevation),
        "their zenith angles are elevations": (azimuth, 0.5 * np.pi - elevation),
        "their azimuths are clockwise": (-azimuth, elevation),
        "their azimuths are counted from north": (0.5 * np.pi - azimuth, elevation),
    }
    fits = [text for text, (az, el) in others.items() if off(az, el).max() < tolerance_rad]
    why = f": it would if {fits[0]}" if fits else ""
    row = np.flatnonzero(known)[int(np.argmax(error))]
    by = np.degrees(error.max())
    raise InputError(f"{name}: the angle of {end} of path {row} does not point along its leg, by {by:.1f} deg{why}")


def _vt_numbers(vt: Floats, transmitter: Ints, order: Ints) -> Ints:
    """Return a number (P,) for each VT, -1 for lines of sight."""
    from scipy.spatial import cKDTree

    out = np.full(len(vt), -1, np.int64)
    rows = np.flatnonzero(order > 0)
    if not len(rows):
        return out
    # Images of different transmitters and orders are kept apart by more than any distance.
    apart = 1e7 * np.column_stack([transmitter[rows], order[rows]])
    cell = np.round(np.column_stack([vt[rows], apart]) / (0.5 * SAME_VT_M)).astype(np.int64)
    kept, inverse = np.unique(cell, axis=0, return_inverse=True)
    pairs = cKDTree(kept * (0.5 * SAME_VT_M)).query_pairs(SAME_VT_M, output_type="ndarray")
    out[rows] = connected(pairs, len(kept))[inverse.reshape(-1)]
    return out


def zenith(elevation_rad: Floats) -> Floats:
    """Return zenith angles of elevations, or elevations of zenith angles, (...,) in rad."""
    return 0.5 * np.pi - elevation_rad


class ByLink:
    """Makes arrays by receiver, transmitter and place in the link, the strongest path first, as formats hold them."""

    def __init__(self, paths: Paths, receivers: int, transmitters: int) -> None:
        link = paths.receiver * transmitters + paths.transmitter
        order = np.lexsort((-paths.gain_db, link))
        begin = np.searchsorted(link[order], np.arange(receivers * transmitters))
        place = np.empty(len(link), np.int64)
        place[order] = np.arange(len(link)) - begin[link[order]]
        self._at = paths.receiver, paths.transmitter, place
        self._shape = receivers, transmitters, int(place.max(initial=-1)) + 1

    def filled(self, values: NDArray[Any], padding: float) -> NDArray[Any]:
        """Return values (P, ...), of any unit, as (receivers, transmitters, places, ...)."""
        out = np.full((*self._shape, *values.shape[1:]), padding, values.dtype)
        out[self._at] = values
        return out
