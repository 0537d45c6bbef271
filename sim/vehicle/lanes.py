"""A polyline as a chain of highway-env lanes: straight pieces, and an arc round every corner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError

Floats = NDArray[np.float64]

STRAIGHT_RAD = 1e-3
"""A bend below this angle is no corner."""


@dataclass(frozen=True)
class Lanes:
    """A highway-env `network` whose lanes (`indices`, in driving order) are sampled as the centre line.

    `points_m` (n, 2), `arc_m` (n,), `heading_rad` (n,) unwrapped, `curvature_per_m` (n,), left positive.
    """

    network: Any
    indices: tuple[tuple[str, str, int], ...]
    points_m: Floats
    arc_m: Floats
    heading_rad: Floats
    curvature_per_m: Floats


def build_lanes(corners_m: Floats, radius_m: float, least_radius_m: float, step_m: float = 0.1) -> Lanes:
    """Return the lanes along the polyline `corners_m` (k, 2), in m, rounded with `radius_m` or what fits.

    Raises InputError naming the corner where less than `least_radius_m` fits.
    """
    from highway_env.road.road import RoadNetwork

    corners = without_repeats(np.asarray(corners_m, np.float64))
    pieces = _pieces(corners, *_arcs(corners, radius_m, least_radius_m))
    network = RoadNetwork()
    indices = []
    for i, (lane, _) in enumerate(pieces):
        network.add_lane(str(i), str(i + 1), lane)
        indices.append((str(i), str(i + 1), 0))
    return Lanes(network, tuple(indices), *_sample(pieces, step_m))


def without_repeats(points_m: Floats) -> Floats:
    """Return the points (k, 2), in m, without immediate repeats and without those where the line does not bend."""
    keep = np.r_[True, np.hypot(*np.diff(points_m, axis=0).T) > 1e-6]
    points = points_m[keep]
    if len(points) < 2:
        raise InputError("the route has no length: all its waypoints are one point; give at least two")
    bend = np.abs(_turns(points)) > STRAIGHT_RAD
    return points[np.r_[True, bend, True]]


def _turns(points: Floats) -> Floats:
    """Return the turn at each inner point, (k - 2,), left positive."""
    step = np.diff(points, axis=0)
    a, b = step[:-1], step[1:]
    return np.asarray(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)))


def _arcs(corners: Floats, radius_m: float, least_radius_m: float) -> tuple[Floats, Floats]:
    """Return turn and radius at each inner corner; neighbouring arcs share the leg between them."""
    turn = _turns(corners)
    leg = np.hypot(*np.diff(corners, axis=0).T)
    share = np.full(len(leg), 0.5)
    share[[0, -1]] = 1.0
    room = np.minimum((leg * share)[:-1], (leg * share)[1:])
    radius = np.minimum(radius_m, room / np.tan(np.abs(turn) / 2.0))
    tight = np.flatnonzero(radius < least_radius_m)
    if len(tight):
        i = int(tight[0])
        x, y = corners[i + 1]
        raise InputError(
            f"the route's corner at ({x:.1f}, {y:.1f}) m turns by {np.degrees(turn[i]):.0f} degrees: "
            f"a radius of {radius[i]:.1f} m fits, the vehicle needs {least_radius_m:.1f} m; "
            "move the neighbouring waypoints away or turn less"
        )
    return turn, radius


def _pieces(corners: Floats, turn: Floats, radius: Floats) -> list[tuple[Any, float]]:
    """Return (lane, curvature) in driving order."""
    from highway_env.road.lane import CircularLane, StraightLane

    pieces: list[tuple[Any, float]] = []
    start = corners[0]
    for corner, after, angle, r in zip(corners[1:-1], corners[2:], turn, radius, strict=True):
        tangent = r * np.tan(abs(angle) / 2.0)
        along = (corner - start) / np.hypot(*(corner - start))
        leave = corner + tangent * (after - corner) / np.hypot(*(after - corner))
        begin = corner - tangent * along
        if np.hypot(*(begin - start)) > 1e-9:
            pieces.append((StraightLane(start, begin), 0.0))
        side = np.sign(angle)
        centre = begin + side * r * np.array([-along[1], along[0]])
        first = np.arctan2(*(begin - centre)[::-1])
        # highway-env's y axis points down, so its "clockwise" is a left turn here.
        arc = CircularLane(centre, r, first, first + angle, clockwise=bool(side > 0))
        pieces.append((arc, side / r))
        start = leave
    if np.hypot(*(corners[-1] - start)) > 1e-9:
        pieces.append((StraightLane(start, corners[-1]), 0.0))
    return pieces


def _sample(pieces: list[tuple[Any, float]], step_m: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return points, arc length, heading and curvature, every `step_m` or a little less within each lane."""
    columns: list[tuple[float, float, float, float, float]] = []
    done = 0.0
    for i, (lane, curvature) in enumerate(pieces):
        count = max(int(np.ceil(lane.length / step_m)), 1)
        last = i == len(pieces) - 1
        for s in np.linspace(0.0, lane.length, count + 1)[: None if last else -1]:
            x, y = lane.position(s, 0.0)
            columns.append((x, y, done + s, lane.heading_at(s), curvature))
        done += lane.length
    table = np.array(columns)
    return table[:, :2].copy(), table[:, 2].copy(), np.unwrap(table[:, 3]), table[:, 4].copy()
