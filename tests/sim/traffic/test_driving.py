"""The traffic's motion: highway-env's own IDM and MOBIL as oracles, and what low speed must not do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from highway_env.road.road import Road as HighwayRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from shapely import LineString, intersects, points, polygons

from cellslam.scenarios.loading import load
from cellslam.sim.errors import InputError
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.traffic import Traffic, TrafficConfig
from cellslam.sim.traffic.driving import STEP_S, lanes_that_fit
from cellslam.sim.traffic.driving_kernel import RADIUS_M, Cars, Road, drive_all, is_better, progress
from cellslam.sim.vehicle import plan_route
from cellslam.sim.world import prepare

Array = np.ndarray
WIDTH = 4.0


def cars(along: Array, lane: Array, speed: Array, wanted: Array, size_m: float = 5.0) -> Cars:
    """Vehicles in the middle of lanes 4 m wide; the last one is ours."""
    count = len(along)
    return Cars(
        along.astype(float), WIDTH * lane, speed.astype(float), np.zeros(count), lane.copy(), np.zeros(count),
        np.full(count, size_m), wanted.astype(float),
    )  # fmt: skip


def road(lanes: int, limit_mps: float = 100.0) -> Road:
    """So long that who is ahead is not behind as well."""
    return Road(1e7, WIDTH * np.arange(lanes), WIDTH, np.full(10, limit_mps))


def highway(some: Cars, lanes: int) -> list[Any]:
    """The same vehicles as highway-env's own."""
    network = RoadNetwork.straight_road_network(lanes, length=5000.0, speed_limit=100.0)
    there = HighwayRoad(network, np_random=np.random.RandomState(0))
    there.vehicles = [
        IDMVehicle(there, [some.along[i], some.side[i]], 0.0, some.speed[i], target_speed=some.wanted[i])
        for i in range(len(some.along))
    ]
    return there.vehicles


def test_lanes_are_changed_when_highway_env_changes_them() -> None:
    rng = np.random.default_rng(3)
    yes = 0
    for _ in range(150):
        along, lane = np.sort(rng.uniform(100.0, 250.0, 8)), rng.integers(0, 3, 8)
        # Nobody is faster than he wants to be: on our ring there is always somebody behind, if far away.
        speed = rng.uniform(1.0, 12.0, 8)
        some = cars(along, lane, speed, speed + rng.uniform(0.0, 5.0, 8))
        theirs = highway(some, 3)
        for i in range(8):
            for other in (lane[i] - 1, lane[i] + 1):
                if 0 <= other < 3:
                    expected = theirs[i].mobil(("0", "1", int(other)))
                    assert is_better(some, i, int(other), road(3)) == expected
                    yes += expected
    assert yes > 50


def test_vehicles_follow_as_those_of_highway_env() -> None:
    along, count = np.array([300.0, 280.0, 262.0, 240.0, 200.0, 330.0]), 200
    lane, speed = np.zeros(6, int), np.array([8.0, 7.0, 9.0, 6.0, 12.0, 5.0])
    some = cars(along, lane, speed, np.full(6, 10.0))
    theirs = highway(some, 1)
    step_s = 0.05
    ours = np.column_stack([330.0 + 5.0 * step_s * np.arange(count + 1), np.full(count + 1, 5.0)])
    states = drive_all(some, ours, road(1), step_s, 1)
    theirs[-1].target_speed = 5.0
    worst = 0.0
    for t in range(count):
        for vehicle in theirs[:-1]:
            vehicle.act()
        theirs[-1].act()
        theirs[-1].action = {"steering": 0.0, "acceleration": 0.0}
        for vehicle in theirs:
            vehicle.step(step_s)
        worst = max(worst, *(abs(v.position[0] - x) for v, x in zip(theirs[:-1], states[t + 1, :, 0], strict=True)))
    # highway-env moves by the speed before a step, we by the mean: half of an acceleration's step in a start.
    assert worst < 0.25
    assert np.ptp(states[-1, :, 0]) > 30.0


def test_a_queue_stands_still() -> None:
    count, queue = 1200, 6
    along = 300.0 - 16.0 * np.array([*range(1, queue + 1), 0])
    some = cars(along, np.zeros(queue + 1, int), np.append(np.full(queue, 6.0), 0.0), np.full(queue + 1, 8.0))
    some.side[:-1] = 0.3
    # Ours stands for 40 s, creeps at 0.3 m/s for 40 s, and stands.
    speed = np.where((np.arange(count) >= 400) & (np.arange(count) < 800), 0.3, 0.0)
    ours = np.column_stack([300.0 + STEP_S * np.append(0.0, np.cumsum(speed))[:count], speed])
    states = drive_all(some, ours, road(1), STEP_S, 1)
    moved = np.diff(states[..., 0], axis=0)
    assert moved.min() >= 0.0
    for standing in (moved[300:400], moved[1100:]):
        assert standing.max() < 1e-4
    assert np.ptp(states[300:400, :, 2], axis=0).max() < 1e-4
    # Nobody turns on the spot.
    way = np.hypot(moved, np.diff(states[..., 1], axis=0))
    assert (np.abs(np.diff(states[..., 2], axis=0)) <= way / RADIUS_M + 1e-9).all()
    assert np.ptp(states[..., 2]) > 0.01
    # While all creep, speeds vary slowly: no vehicle stops and goes.
    creeping = moved[600:800] / STEP_S
    assert (creeping > 0.1).all() and np.abs(np.diff(creeping, axis=0)).max() < 0.05
    gaps = np.diff(-np.column_stack([ours[-1:, 0], states[-1:, :, 0]]))
    assert gaps.min() > 9.0


@pytest.mark.parametrize("size_m", [5.0, 12.0])
def test_vehicles_stop_five_metres_behind_another(size_m: float) -> None:
    some = cars(np.array([200.0, 300.0]), np.zeros(2, int), np.array([8.0, 0.0]), np.full(2, 8.0), size_m)
    states = drive_all(some, np.tile([300.0, 0.0], (600, 1)), road(1), STEP_S, 1)
    assert 300.0 - states[-1, 0, 0] - size_m == pytest.approx(5.0, abs=0.7)


def test_progress_goes_on_where_a_line_crosses_itself() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 2001)
    eight = np.column_stack([50.0 * np.sin(angle), 25.0 * np.sin(2.0 * angle)])
    arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(eight, axis=0).T)))
    found = progress(eight, arc, eight[::7] + 0.2)
    np.testing.assert_allclose(found, arc[::7], atol=0.4)
    assert (np.diff(found) > 0.0).all()


@pytest.fixture(scope="module")
def drive() -> tuple[Any, Any, Traffic]:
    scenario = load("canyon", {"traffic.vehicles_per_km": 40.0})
    world = prepare(scenario.world, 75000, 0)
    assert world.traffic is not None
    route = plan_route(world.scene.city, scenario.vehicle, stream(75000, 0, Stream.ROUTE))
    return world, route, world.traffic


def test_vehicles_are_on_lanes_and_apart(drive: tuple[Any, Any, Traffic]) -> None:
    world, route, traffic = drive
    assert len(traffic) == 3 * round(40.0 * route.length_m / 1000.0)
    assert traffic.time_s[0] == 0.0 and traffic.time_s[-1] >= world.drive.time_s[-1]
    away = LineString(route.points_m[::10]).distance(points(traffic.poses[::20, :, :2].reshape(-1, 2)))
    assert away.max() < 1.5 * 3.5
    outlines = polygons(traffic.outlines(np.arange(0.0, 510.0, 30.0)))
    pairs = [sum(one.intersects(other) for one in row for other in row) - len(row) for row in outlines]
    assert sum(pairs) < 0.02 * outlines.size


def test_nobody_drives_through_our_vehicle(drive: tuple[Any, Any, Traffic]) -> None:
    world, route, traffic = drive
    poses, when = world.drive.poses[::20], world.drive.time_s[::20]
    # Bumpers and sides as seen from the rear axle.
    corners = np.array([[3.9, 0.8], [-1.0, 0.8], [-1.0, -0.8], [3.9, -0.8]])
    c, s = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    ours = poses[:, None, :2] + np.einsum("tij,kj->tki", np.moveaxis([[c, -s], [s, c]], 2, 0), corners)
    met = intersects(polygons(traffic.outlines(when)), polygons(ours)[:, None]).any(axis=1)
    bends = route.arc_m[np.abs(route.curvature_per_m) > 0.01]
    place = progress(route.points_m, route.arc_m, np.ascontiguousarray(poses[:, :2]))
    in_bend = np.abs(place[:, None] - bends[None, ::10]).min(axis=1) < 12.0
    assert not met[~in_bend].any() and (~in_bend).sum() > 100
    # In a bend of 8 m a bus on the next lane takes more room than there is.
    assert met.mean() < 0.02


@pytest.mark.slow
def test_kinds_come_in_their_shares() -> None:
    config = load("canyon", {"traffic.vehicles_per_km": 60.0, "traffic.bus_share": 0.0, "traffic.van_share": 0.4}).world
    worlds = [prepare(config, 75000, trial) for trial in range(4)]
    kinds = [kind for world in worlds if world.traffic is not None for kind in world.traffic.kind]
    share = {kind: kinds.count(kind) / len(kinds) for kind in set(kinds)}
    assert share == pytest.approx({"car": 0.55, "van": 0.4, "lorry": 0.05}, abs=0.07)
    with pytest.raises(InputError, match="add up to"):
        load("canyon", {"traffic.van_share": 1.0})


def test_lanes_that_do_not_fit_are_left_out(drive: tuple[Any, Any, Traffic]) -> None:
    world, route, _ = drive
    config, city = TrafficConfig(lanes=3, oncoming_lanes=3), world.scene.city
    ahead, oncoming = lanes_that_fit(config, city, route)
    # Streets of 16 m: 8 m to either side, and a third of the route has a bay or a square.
    assert ahead.tolist() == [0.0, -3.5] and oncoming.tolist() == [3.5]
    open_city = replace(city, footprints=[])
    assert [len(lanes) for lanes in lanes_that_fit(config, open_city, route)] == [3, 3]
