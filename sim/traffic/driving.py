"""Traffic is drawn and driven: vehicles on lanes parallel to the route, in both directions, ours among them.

Our vehicle drives as it would without traffic: others follow, brake for and overtake it, it reacts to nobody.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.city.city import City
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.traffic.traffic import Traffic
from cellslam.sim.traffic.traffic_config import KINDS, TrafficConfig
from cellslam.sim.vehicle import Drive, Route, VehicleConfig

STEP_S = 0.1
KEPT = 5  # steps from one pose to the next that is kept
BEFORE_S = 30.0  # the traffic flows already when our vehicle begins
LATERAL_MPS2 = 2.0  # in bends
OUR_LENGTH_M = 5.0
SPREAD = 0.2  # of the wanted speeds, to either side
NOBODY_M = 1e6  # to the side: where our vehicle is for those who come from ahead


def draw_traffic(
    config: TrafficConfig, city: City, route: Route, driven: Drive, vehicle: VehicleConfig, rng: np.random.Generator
) -> Traffic | None:
    """Return the vehicles beside a drive along a route; None where there are none."""
    if config.vehicles_per_km == 0:
        return None  # without compiling anything for them
    from cellslam.sim.traffic.driving_kernel import progress

    ahead, oncoming = lanes_that_fit(config, city, route)
    axle_m = progress(route.points_m, route.arc_m, np.ascontiguousarray(driven.poses[:, :2]))
    before = round(BEFORE_S / STEP_S)
    count = KEPT * (int(np.ceil(driven.time_s[-1] / (STEP_S * KEPT))) + 1)
    when = STEP_S * np.arange(count + 1, dtype=np.float64)
    along = np.interp(when, driven.time_s, axle_m) + 0.5 * vehicle.wheelbase_m
    ours = np.column_stack([along, np.gradient(along, STEP_S)])
    ours = np.concatenate([np.tile([along[0], 0.0], (before, 1)), ours])
    flows = [_flow(config, route, lanes, side, ours, rng) for lanes, side in ((ahead, 1), (oncoming, -1))]
    kinds, sizes, states_of = zip(*flows, strict=True)
    kind, size, states = np.concatenate(kinds), np.concatenate(sizes), np.concatenate(states_of, axis=1)
    if not len(kind):
        return None
    poses = _poses(route, states[before // KEPT :], vehicle.road_slope_percent / 100.0)
    return Traffic(tuple(KINDS[k].name for k in kind), size, when[::KEPT], poses)


def lanes_that_fit(config: TrafficConfig, city: City, route: Route) -> tuple[Floats, Floats]:
    """Return how far to the left, in m, the lanes (L,) of our and of the other direction are from the route, each list
    from its middle outwards. A lane that touches a building anywhere is left out, with those beyond it."""
    import shapely

    normal = np.column_stack([-np.sin(route.heading_rad), np.cos(route.heading_rad)])
    tree = shapely.STRtree(list(city.footprints))

    def fit(numbers: range, side: int) -> Floats:
        found = []
        for number in numbers:
            line = shapely.LineString(route.points_m + side * number * config.lane_width_m * normal)
            if number and len(tree.query(line, predicate="dwithin", distance=0.5 * config.lane_width_m)):
                break
            found.append(side * number * config.lane_width_m)
        return np.array(found, np.float64)

    return fit(range(config.lanes), -1), fit(range(1, config.oncoming_lanes + 1), 1)


def _flow(
    config: TrafficConfig, route: Route, lanes: Floats, direction: int, ours: Floats, rng: np.random.Generator
) -> tuple[Ints, Floats, Floats]:
    """Return kind (N,), size (N, 3) and states (K, N, 3): arc of the route, side, heading, of one direction."""
    from cellslam.sim.traffic.driving_kernel import DELAY_S, Cars, Road, drive_all

    length = route.length_m
    each = round(config.vehicles_per_km * length / 1000.0)
    lane = np.repeat(np.arange(len(lanes)), each)
    count = len(lane)
    # Evenly but for a tenth; the first place is that of our vehicle.
    slot = np.tile(np.arange(1, each + 1), len(lanes)) + rng.uniform(-0.1, 0.1, count)
    kind = rng.choice(len(KINDS), count, p=np.array(config.shares) / sum(config.shares))
    size = np.array([[k.length_m, k.width_m, k.height_m] for k in KINDS])[kind]
    wanted = config.speed_mps * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, count)
    timer = rng.uniform(0.0, DELAY_S, count)
    own = 0.0 if direction > 0 else NOBODY_M
    cars = Cars(
        along=np.append((ours[0, 0] + slot * length / (each + 1)) % length, 0.0),
        side=np.append(direction * lanes[lane], own),
        speed=np.append(0.5 * wanted, 0.0), heading=np.zeros(count + 1), lane=np.append(lane, 0),
        timer=np.append(timer, 0.0), size=np.append(size[:, 0], OUR_LENGTH_M),
        wanted=np.append(wanted, config.speed_mps),
    )  # fmt: skip
    road = Road(length, direction * lanes, config.lane_width_m, _limit(route)[::direction].copy())
    states = drive_all(cars, ours, road, STEP_S, KEPT)
    if direction < 0:
        states = np.stack([length - states[..., 0], -states[..., 1], states[..., 2] + np.pi], axis=-1)
    return kind, size, states


def _limit(route: Route) -> Floats:
    """Return the speed in m/s that bends allow, on cells of a metre along the route, from either direction."""
    arc = np.arange(0.5, max(route.length_m, 1.0))
    bend = np.maximum(np.abs(np.interp(arc, route.arc_m, route.curvature_per_m)), 1e-6)
    square, slope = LATERAL_MPS2 / bend, 2.0 * LATERAL_MPS2 * arc
    square = np.minimum.accumulate((square + slope)[::-1])[::-1] - slope
    return np.asarray(np.sqrt(np.minimum.accumulate(square - slope) + slope))


def _poses(route: Route, states: Floats, slope: float) -> Floats:
    """Return x, y, ground, yaw (K, N, 4) of arc, side, heading relative to the route (K, N, 3)."""
    arc, side, heading = np.moveaxis(states, -1, 0)
    yaw = np.interp(arc, route.arc_m, route.heading_rad)
    x, y = (np.interp(arc, route.arc_m, column) for column in route.points_m.T)
    ground = route.ground_m + slope * arc
    return np.stack([x - side * np.sin(yaw), y + side * np.cos(yaw), ground, yaw + heading], axis=-1)
