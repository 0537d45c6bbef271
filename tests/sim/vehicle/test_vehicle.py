"""Route, follower, speed profile and the true drive."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity, wrap_angle
from cellslam.sim.vehicle import Drive, Route, VehicleConfig, drive, plan_route
from cellslam.sim.vehicle.follower_kernel import follow
from cellslam.sim.vehicle.route import rounded
from cellslam.sim.vehicle.speed_profile import speed_profile
from cellslam.sim.vehicle.street_walk import SHARP_RAD, random_walk, street_network

BLOCKS = np.arange(-300.0, 301.0, 75.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def city() -> Any:
    """Eight by eight square blocks, streets 20 m wide."""
    streets = [np.array([[x, -300.0], [x, 300.0]]) for x in BLOCKS]
    streets += [np.array([[-300.0, y], [300.0, y]]) for y in BLOCKS]
    houses = tuple(shapely.box(x + 10, y + 10, x + 65, y + 65) for x in BLOCKS[:-1] for y in BLOCKS[:-1])
    return SimpleNamespace(name="grid", streets=tuple(streets), footprints=houses, road_m=0.0)


def deviation_m(route: Route, driven: Drive) -> np.ndarray:
    return np.asarray(shapely.distance(shapely.points(driven.poses[:, :2]), shapely.LineString(route.points_m)))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_corner_is_rounded_by_the_arc_that_touches_both_legs(side: float) -> None:
    route = rounded(np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 40.0 * side]]), radius_m=10.0, least_radius_m=4.0)
    assert route.length_m == pytest.approx(40.0 + 5.0 * np.pi + 30.0)
    on_arc = route.curvature_per_m * side > 0.0
    np.testing.assert_allclose(np.hypot(*(route.points_m[on_arc] - (40.0, 10.0 * side)).T), 10.0, atol=1e-9)
    np.testing.assert_allclose(route.heading_rad[[0, -1]], [0.0, side * np.pi / 2], atol=1e-12)
    assert np.all(np.diff(route.arc_m) > 0.0)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"waypoints_m": ((0.0, 0.0), (0.0, 100.0))}, "100.0 m long, but vehicle.distance_m = 530"),
        ({"waypoints_m": ((0.0, 0.0), (0.0, 100.0), (0.0, 0.0))}, "turns by"),
        ({"waypoints_m": ((0.0, 37.5), (600.0, 37.5))}, r"a wall of building \d+ at \(8\.\d, 37\.5\) m"),
        ({"waypoints_m": ((9.3, -300.0), (9.3, 300.0))}, r"nearer than vehicle\.clearance_m"),
        ({"route": 5, "duration_s": 40.0}, r"vehicle\.duration_s = 40 is too short"),
    ],
)
def test_impossible_drives_are_refused(city: Any, keys: dict[str, Any], message: str) -> None:
    config = VehicleConfig(**keys)
    with pytest.raises(InputError, match=message):
        drive(plan_route(city, config, rng()), config, rng())
    bare = SimpleNamespace(name="bare", streets=(), footprints=())
    with pytest.raises(InputError, match="waypoints_m"):
        plan_route(bare, VehicleConfig(), rng())  # type: ignore[arg-type]


def test_planned_route_is_fixed_by_its_seed_or_drawn_per_trial(city: Any) -> None:
    fixed = [plan_route(city, VehicleConfig(route=5), rng(trial)).points_m for trial in (1, 2)]
    np.testing.assert_array_equal(*fixed)
    drawn = [plan_route(city, VehicleConfig(route="trial"), rng(trial)).points_m for trial in (1, 2)]
    assert not np.array_equal(drawn[0][0], drawn[1][0])


def test_walks_turn_round_only_at_dead_ends(city: Any) -> None:
    network = street_network(city.streets)
    for seed in range(20):
        walk, cost = random_walk(network, 600.0, rng(seed))
        step = np.diff(walk, axis=0)
        assert np.hypot(*step.T).sum() >= 600.0
        turn = np.abs(wrap_angle(np.diff(np.arctan2(step[:, 1], step[:, 0]))))
        assert turn.max() < SHARP_RAD
        assert cost < 1000.0
    dead_end = street_network([np.array([[0.0, 0.0], [100.0, 0.0]])])
    assert random_walk(dead_end, 150.0, rng())[1] > 1000.0


@pytest.mark.parametrize("speed_mps", [0.05, 0.3, 1.0, 3.0, 10.0])
def test_follower_converges_without_chatter(speed_mps: float) -> None:
    """From a metre beside a straight path: the steering changes sides a few times at most, and then stays still."""
    path = np.column_stack([np.arange(0.0, 400.0, 0.1), np.zeros(4000)])
    speed = np.full(int(max(40.0 / speed_mps, 30.0) / 0.015), speed_mps)
    poses, curvature = follow(path, path[:, 0].copy(), np.array([0.0, 1.0, 0.0]), speed, 0.015, 2.9)
    assert abs(poses[-1, 1]) < 0.01 and poses[:, 1].min() > -0.12
    assert np.count_nonzero(np.diff(np.sign(curvature[np.abs(curvature) > 1e-6]))) <= 4
    tail = curvature[len(curvature) // 2 :]
    assert np.abs(tail).max() < 0.01 and np.abs(np.diff(tail)).max() < 1e-4


def test_follower_stays_on_the_route_and_holds_the_wheel_when_standing(city: Any) -> None:
    config = VehicleConfig(route=5)
    route = plan_route(city, config, rng())
    driven = drive(route, config, rng(1))
    assert deviation_m(route, driven).max() < 0.25
    standing = driven.velocity[:, 0] == 0.0
    assert np.abs(driven.velocity[standing, 3]).max() == 0.0
    assert (np.abs(driven.velocity[:, 3]) < 1e-3).mean() > 0.6  # on straights


@pytest.mark.parametrize("seed", range(2))
def test_distance_and_duration_come_out(city: Any, seed: int) -> None:
    config = VehicleConfig(route=5)
    driven = drive(plan_route(city, config, rng()), config, rng(seed))
    assert driven.time_s.shape == (6850,)
    assert driven.time_s[-1] == pytest.approx(513.75 - 0.075)
    assert driven.distance_m == pytest.approx(530.0, rel=1e-4)
    assert driven.velocity[[0, -1], 0] == pytest.approx(0.0, abs=1e-3)
    assert 0.0 < driven.velocity[:, 0].max() < 2.5


def test_speed_profile_stops_where_told_and_sums_up() -> None:
    config = VehicleConfig(stops=3, stop_s=10.0, speed_variation=0.3)
    speed = speed_profile(np.array([0.0, 600.0]), np.zeros(2), config, 0.015, 34245, rng(3))
    assert speed.sum() * 0.015 == pytest.approx(530.0, rel=1e-12)
    assert speed.min() >= 0.0
    still = (speed == 0.0).astype(int)
    assert np.count_nonzero(np.diff(still) == 1) == 4
    assert np.abs(np.diff(speed)).max() / 0.015 <= config.acceleration_mps2 * 1.01


def test_turns_slow_the_vehicle_down() -> None:
    arc, bend = np.linspace(0.0, 100.0, 1001), np.zeros(1001)
    bend[400:600] = 0.2
    config = VehicleConfig(
        distance_m=100.0, duration_s=50.0, stops=0, lateral_acceleration_mps2=0.5, speed_variation=0.0
    )
    speed = speed_profile(arc, bend, config, 0.015, 3333, rng())
    position = np.cumsum(speed) * 0.015
    in_turn = (position > 42.0) & (position < 58.0)
    assert speed[in_turn].max() == pytest.approx(np.sqrt(0.5 / 0.2), rel=0.02)
    assert speed.max() > 2.0


def test_velocities_are_the_derivative_of_the_poses(city: Any) -> None:
    config = VehicleConfig(route=5, road_slope_percent=3.0)
    driven = drive(plan_route(city, config, rng()), config, rng(2))
    mean = mean_velocity(driven.poses[:-1], driven.poses[1:], np.diff(driven.time_s))
    between = 0.5 * (driven.velocity[1:] + driven.velocity[:-1])
    np.testing.assert_allclose(mean[:, :3], between[:, :3], atol=2e-3)
    np.testing.assert_allclose(mean[:, 3:], between[:, 3:], atol=3e-3)
    assert np.abs(driven.velocity[:, 1]).max() < 1e-3


def test_braking_dips_the_nose_and_a_left_turn_leans_right() -> None:
    open_field = SimpleNamespace(name="field", streets=(), footprints=(), road_m=0.0)
    config = VehicleConfig(
        waypoints_m=((0, 0), (60, 0), (60, 60)), distance_m=90.0, duration_s=80.0, stops=0,
        road_height_std_m=0.0, road_roll_std_deg=0.0, speed_variation=0.0,
    )  # fmt: skip
    driven = drive(plan_route(open_field, config, rng()), config, rng())  # type: ignore[arg-type]
    acceleration = np.gradient(driven.velocity[:, 0], driven.time_s)
    hard = np.abs(acceleration) > 0.5
    np.testing.assert_allclose(driven.poses[hard, 4], -np.radians(0.25) * acceleration[hard], atol=1e-3)
    assert driven.poses[:, 5].max() > np.radians(0.05)
    assert driven.poses[:, 5].min() > -np.radians(0.02)


def test_uphill_slope_raises_the_nose_along_the_motion(city: Any) -> None:
    config = VehicleConfig(route=5, road_slope_percent=5.0, road_height_std_m=0.0, pitch_gradient_deg_per_mps2=0.0)
    driven = drive(plan_route(city, config, rng()), config, rng())
    assert driven.poses[-1, 2] - driven.poses[0, 2] == pytest.approx(0.05 * 530.0, rel=1e-3)
    np.testing.assert_allclose(driven.poses[:, 4], -np.arctan(0.05), atol=1e-9)
    assert np.abs(driven.velocity[:, 2]).max() < 1e-3
