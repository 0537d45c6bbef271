"""Which points are inside a building or under the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.city.city import GROUND, City, Floats, Ints
from cellslam.sim.errors import InputError

OUTSIDE, UNDERGROUND = -1, -2
SAME_SURFACE_M = 0.01


def enclosing(city: City, points_m: ArrayLike) -> Ints:
    """Return per point (N, 3), in m, the building that it is in, -1 (outside) or -2 (under the ground).

    A point is in a building if an odd number of that building's surfaces lies above it: courtyards, passages and
    parts inside one another come out right, floors are not needed. Surfaces a centimetre apart count once.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    point, building, height = surfaces(city, points)
    above = height > points[point, 2]
    found = np.full(len(points), OUTSIDE, np.int64)
    ground_above = np.zeros(len(points), np.bool_)
    ground_below = np.zeros(len(points), np.bool_)
    ground_above[point[(building == GROUND) & above]] = True
    ground_below[point[(building == GROUND) & ~above]] = True
    found[ground_above & ~ground_below] = UNDERGROUND
    keep = above & (building != GROUND)
    point, building, height = point[keep], building[keep], height[keep]
    order = np.lexsort((height, building, point))
    point, building, height = point[order], building[order], height[order]
    fresh = np.ones(len(point), np.bool_)
    same = (np.diff(point) == 0) & (np.diff(building) == 0)
    fresh[1:] = ~same | (np.diff(height) > SAME_SURFACE_M)
    start = np.flatnonzero(np.r_[True, ~same][: len(point)])
    odd = (np.add.reduceat(fresh, start) % 2 == 1) if len(start) else np.zeros(0, np.bool_)
    found[point[start[odd]]] = building[start[odd]]
    return found


def roof_height(city: City, x_m: float, y_m: float) -> float:
    """Return the height of the highest building surface at (x, y); -inf in the open."""
    _, building, height = surfaces(city, np.array([[x_m, y_m, 0.0]]))
    return float(height[building != GROUND].max(initial=-np.inf))


def check_outside(city: City, points_m: ArrayLike, what: str) -> None:
    """Raise InputError, with a remedy, for the first of the points (N, 3), in m, in a building or under the ground."""
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    where = enclosing(city, points)
    for index in np.flatnonzero(where != OUTSIDE):
        place = ", ".join(f"{c:.2f}" for c in points[index])
        if where[index] == UNDERGROUND:
            raise InputError(f"{what} {index} at ({place}) is under the ground: raise it")
        _, building, height = surfaces(city, points[index : index + 1])
        roof = float(height[building == where[index]].max())
        raise InputError(
            f"{what} {index} at ({place}) is inside building {where[index]}, whose roof is at {roof:.2f} m there: "
            "raise it above the roof or move it"
        )


def surfaces(city: City, points: Floats) -> tuple[Ints, Ints, Floats]:
    """Return (point, building, height in m) of the surfaces over or under points (N, 3), in m; of no vertical ones."""
    import shapely

    point, triangle = city.plans.query(shapely.points(points[:, :2]))
    a, b, c = city.vertices[city.triangles[triangle]].transpose(1, 0, 2)
    p = points[point]
    area = _cross(b - a, c - a)
    flat = np.abs(area) > 1e-9
    safe = np.where(flat, area, 1.0)
    u, v = _cross(p - a, c - a) / safe, _cross(b - a, p - a) / safe
    hit = flat & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
    height = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
    building = city.facets.building[city.triangle_facet[triangle]]
    return point[hit].astype(np.int64), building[hit], height[hit]


def _cross(p: Floats, q: Floats) -> Floats:
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], np.float64)
