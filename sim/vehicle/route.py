"""The route: along given waypoints or planned on the city's streets, corners rounded, and clear of its walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.city import City
from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats
from cellslam.sim.vehicle.street_walk import random_walk, street_network
from cellslam.sim.vehicle.vehicle_config import VehicleConfig

MARGIN_M = 5.0  # a planned route is longer than the drive by this, for the follower cuts corners and looks ahead
STEP_M = 0.1  # between two points of the centre line, or a little less
STRAIGHT_RAD = 1e-3  # a bend below this angle is no corner
STEERING_LIMIT_RAD = 0.6
# Random walks drawn at most; the best of the first GOOD_WALKS that can be driven is the route.
CANDIDATES, GOOD_WALKS = 100, 8


@dataclass(frozen=True, repr=False)
class Route(Described):
    """A way through the city: straight pieces, and an arc round every corner.

    Centre line sampled every `STEP_M` or less: `points_m` (n, 2), `arc_m` (n,), `heading_rad` (n,) unwrapped,
    `curvature_per_m` (n,), positive to the left. `corners_m` (k, 2): the waypoints that it was built from. `ground_m`:
    height of the road.
    """

    points_m: Floats
    arc_m: Floats
    heading_rad: Floats
    curvature_per_m: Floats
    corners_m: Floats
    ground_m: float = 0.0

    @property
    def length_m(self) -> float:
        """Length of the centre line."""
        return float(self.arc_m[-1])


def plan_route(city: City, config: VehicleConfig, rng: np.random.Generator) -> Route:
    """Return the route through `city`: the waypoints, or the best of some random walks on the streets.

    `rng` is drawn from only where `config.route` is "trial" and there are no waypoints. Raises InputError
    where the route meets a wall (naming the place), is too short, or turns too tightly.
    """
    if config.waypoints_m is None:
        return _planned(city, config, rng if config.route == "trial" else np.random.default_rng(config.route))
    route = _driveable(city, config, np.array(config.waypoints_m, np.float64))
    if route.length_m < config.distance_m:
        raise InputError(
            f"the route is {route.length_m:.1f} m long, but vehicle.distance_m = {config.distance_m:g}: "
            "add waypoints or shorten the distance"
        )
    return route


def _planned(city: City, config: VehicleConfig, rng: np.random.Generator) -> Route:
    network = street_network(city.streets)
    length_m = config.distance_m + MARGIN_M
    good: list[tuple[float, Route]] = []
    problem = InputError("the streets are too short")
    for _ in range(CANDIDATES):
        # Rounding takes up to 0.43 radii off a right-angled corner, hence the longer walk.
        corners, cost = random_walk(network, 1.1 * length_m + 20.0, rng)
        try:
            route = _driveable(city, config, corners)
        except InputError as error:
            problem = error
            continue
        if route.length_m >= length_m:
            good.append((cost, route))
        if len(good) == GOOD_WALKS:
            break
    if not good:
        raise InputError(
            f"no route of {config.distance_m:g} m was found on the streets of {city.name} "
            f"(last try: {problem}): choose another vehicle.route or city.seed, or shorten vehicle.distance_m"
        )
    return min(good, key=lambda pair: pair[0])[1]


def _driveable(city: City, config: VehicleConfig, corners_m: Floats) -> Route:
    """Return the route along the corners (k, 2). Raises InputError naming the first place where it comes nearer than
    `config.clearance_m` to a building, or a corner that is too tight.
    """
    import shapely

    route = rounded(corners_m, config.corner_radius_m, config.wheelbase_m / np.tan(STEERING_LIMIT_RAD), city.road_m)
    if not city.footprints:
        return route
    line = shapely.LineString(route.points_m)
    near = shapely.STRtree(city.footprints).query(line, predicate="dwithin", distance=config.clearance_m)
    if len(near) == 0:
        return route
    points = shapely.points(route.points_m)
    gap = np.array([shapely.distance(points, city.footprints[int(i)]) for i in near])
    step = int(np.argmax((gap < config.clearance_m).any(axis=0)))
    building = int(near[int(np.argmin(gap[:, step]))])
    x, y = route.points_m[step]
    through = shapely.intersects(line, city.footprints[building])
    what = "runs through a wall of" if through else f"comes nearer than vehicle.clearance_m = {config.clearance_m:g} to"
    raise InputError(
        f"the route {what} building {building} at ({x:.1f}, {y:.1f}) m, "
        f"{route.arc_m[step]:.1f} m from its start: move the waypoints there"
    )


def rounded(corners_m: Floats, radius_m: float, least_radius_m: float, ground_m: float = 0.0) -> Route:
    """Return the route along the polyline `corners_m` (k, 2), in m, rounded with `radius_m` or what fits.

    Raises InputError naming the corner where less than `least_radius_m` fits.
    """
    corners = _without_repeats(corners_m)
    pieces = []
    start = corners[0]
    turns, radii = _arcs(corners, radius_m, least_radius_m)
    for corner, after, turn, radius in zip(corners[1:-1], corners[2:], turns, radii, strict=True):
        tangent = radius * np.tan(abs(turn) / 2.0)
        along = (corner - start) / np.hypot(*(corner - start))
        begin = corner - tangent * along
        pieces += [_straight(start, begin), _arc(begin, along, turn, radius)]
        start = corner + tangent * (after - corner) / np.hypot(*(after - corner))
    pieces = [piece for piece in [*pieces, _straight(start, corners[-1])] if len(piece)]
    # A piece ends where the next one begins.
    table = np.concatenate([*(piece[:-1] for piece in pieces[:-1]), pieces[-1]])
    before = np.cumsum([0.0, *(piece[-1, 2] for piece in pieces[:-1])])
    sizes = [len(piece) - 1 for piece in pieces[:-1]] + [len(pieces[-1])]
    arc_m = np.repeat(before, sizes) + table[:, 2]
    return Route(table[:, :2].copy(), arc_m, np.unwrap(table[:, 3]), table[:, 4].copy(), corners_m, ground_m)


def _straight(start: Floats, end: Floats) -> Floats:
    """Return x, y, arc length from its start, heading and curvature (n, 5) of a straight piece; none of no length."""
    length = float(np.linalg.norm(end - start))
    if length <= 1e-9:
        return np.empty((0, 5))
    s = _steps(length)
    points, heading = start + s[:, None] * ((end - start) / length), np.arctan2(*(end - start)[::-1])
    return np.column_stack([points, s, np.full(len(s), heading), np.zeros(len(s))])


def _arc(begin: Floats, along: Floats, turn: float, radius: float) -> Floats:
    """Return the same of an arc that begins in a direction (2,) and turns, to the left where that is positive."""
    side = np.sign(turn)
    centre = begin + side * radius * np.array([-along[1], along[0]])
    first = np.arctan2(*(begin - centre)[::-1])
    s = _steps(radius * (first + turn - first) * side)
    phase = side * s / radius + first
    points = centre + radius * np.column_stack([np.cos(phase), np.sin(phase)])
    return np.column_stack([points, s, phase + np.pi / 2 * side, np.full(len(s), side / radius)])


def _steps(length_m: float) -> Floats:
    return np.linspace(0.0, length_m, max(int(np.ceil(length_m / STEP_M)), 1) + 1)


def _without_repeats(points_m: Floats) -> Floats:
    """Return the points (k, 2), in m, without immediate repeats and without those where the line does not bend."""
    points = points_m[np.r_[True, np.hypot(*np.diff(points_m, axis=0).T) > 1e-6]]
    if len(points) < 2:
        raise InputError("the route has no length: all its waypoints are one point; give at least two")
    return points[np.r_[True, np.abs(_turns(points)) > STRAIGHT_RAD, True]]


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
