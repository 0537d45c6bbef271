"""The route: along given waypoints or planned on the city's streets, and clear of its walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.vehicle.lanes import build_lanes
from cellslam.sim.vehicle.street_walk import random_walk, street_network
from cellslam.sim.vehicle.vehicle_config import VehicleConfig

if TYPE_CHECKING:
    from cellslam.sim.city import City

Floats = NDArray[np.float64]

MARGIN_M = 5.0
"""A planned route is longer than the drive by this, for the follower cuts corners and looks ahead."""
STEERING_LIMIT_RAD = 0.6
CANDIDATES = 100
"""Random walks drawn at most; the best of the first GOOD_WALKS that can be driven is the route."""
GOOD_WALKS = 8


@dataclass(frozen=True, repr=False)
class Route(Described):
    """A way through the city on the lanes of a highway-env `network` (`lanes`: indices in driving order).

    Centre line sampled every 0.1 m or less: `points_m` (n, 2), `arc_m` (n,), `heading_rad` (n,) unwrapped,
    `curvature_per_m` (n,), positive to the left. `ground_m`: height of the road. `corners_m` (k, 2): the waypoints
    that it was built from.
    """

    network: Any
    lanes: tuple[tuple[str, str, int], ...]
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
    if config.waypoints_m is not None:
        route = _build(np.array(config.waypoints_m, np.float64), config, city.road_m)
        check_clear(city, route, config.clearance_m)
        if route.length_m < config.distance_m:
            raise InputError(
                f"the route is {route.length_m:.1f} m long, but vehicle.distance_m = {config.distance_m:g}: "
                "add waypoints or shorten the distance"
            )
        return route
    return _planned(city, config, rng if config.route == "trial" else np.random.default_rng(config.route))


def check_clear(city: City, route: Route, clearance_m: float) -> None:
    """Raise InputError naming the first place where the route is nearer than `clearance_m` to a building."""
    import shapely

    if not city.footprints:
        return
    line = shapely.LineString(route.points_m)
    near = shapely.STRtree(city.footprints).query(line, predicate="dwithin", distance=clearance_m)
    if len(near) == 0:
        return
    points = shapely.points(route.points_m)
    gap = np.array([shapely.distance(points, city.footprints[int(i)]) for i in near])
    step = int(np.argmax((gap < clearance_m).any(axis=0)))
    building = int(near[int(np.argmin(gap[:, step]))])
    x, y = route.points_m[step]
    through = shapely.intersects(line, city.footprints[building])
    what = "runs through a wall of" if through else f"comes nearer than vehicle.clearance_m = {clearance_m:g} to"
    raise InputError(
        f"the route {what} building {building} at ({x:.1f}, {y:.1f}) m, "
        f"{route.arc_m[step]:.1f} m from its start: move the waypoints there"
    )


def _build(corners_m: Floats, config: VehicleConfig, road_m: float) -> Route:
    least_m = config.wheelbase_m / np.tan(STEERING_LIMIT_RAD)
    lanes = build_lanes(corners_m, config.corner_radius_m, least_m)
    line = lanes.points_m, lanes.arc_m, lanes.heading_rad, lanes.curvature_per_m
    return Route(lanes.network, lanes.indices, *line, corners_m=corners_m, ground_m=road_m)


def _planned(city: City, config: VehicleConfig, rng: np.random.Generator) -> Route:
    network = street_network(city.streets)
    length_m = config.distance_m + MARGIN_M
    good: list[tuple[float, Route]] = []
    problem = InputError("the streets are too short")
    for _ in range(CANDIDATES):
        # Rounding takes up to 0.43 radii off a right-angled corner, hence the longer walk.
        corners, cost = random_walk(network, 1.1 * length_m + 20.0, rng)
        try:
            route = _build(corners, config, city.road_m)
            check_clear(city, route, config.clearance_m)
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
