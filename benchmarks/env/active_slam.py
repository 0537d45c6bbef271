"""`cellslam/ActiveSlam-v0`: drive so as to arrive, and to know where you are meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from cellslam.benchmarks.env.localization import COLUMNS
from cellslam.benchmarks.env.scenario_env import Observation, ScenarioEnv, Scene
from cellslam.benchmarks.trials.estimation import warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity, wrap_angle
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, Measurements
from cellslam.sim.world import World, known_of, prepare
from cellslam.slam.api import Estimate, Setup, Snapshot

STEERING_LIMIT_RAD, STEERING_RATE_RADPS = 0.6, 0.5
AHEAD, AHEAD_STEP_M = 10, 4.0
GOAL_M = 3.0
WINDOW = 200  # points of the route, before and behind the last one, among which the next is looked for
GOAL_REWARD, CRASH_REWARD = 20.0, -20.0
WIDE = np.array([1e5, 1e5, 1e4, 4.0, 4.0, 4.0])


@dataclass
class Vehicle:
    """A kinematic bicycle, referred to its rear axle, on a flat road: `pose` (6,), speed and steering angle."""

    pose: Floats
    wheelbase_m: float
    acceleration_mps2: float
    speed_mps: float = 0.0
    steering_rad: float = 0.0

    def advance(self, steering_rad: float, speed_mps: float, dt_s: float, parts: int = 5) -> None:
        """Drive for `dt_s` towards the wanted steering angle and speed, with limited rates of both."""
        step = dt_s / parts
        for _ in range(parts):
            turn_most, gain_most = STEERING_RATE_RADPS * step, self.acceleration_mps2 * step
            self.steering_rad += float(np.clip(steering_rad - self.steering_rad, -turn_most, turn_most))
            self.speed_mps += float(np.clip(speed_mps - self.speed_mps, -gain_most, gain_most))
            turn = np.tan(self.steering_rad) / self.wheelbase_m * self.speed_mps * step
            middle = self.pose[3] + 0.5 * turn
            self.pose[:2] += self.speed_mps * step * np.array([np.cos(middle), np.sin(middle)])
            self.pose[3] = float(wrap_angle(self.pose[3] + turn))


class ActiveSlamEnv(ScenarioEnv):
    """The agent steers along the scenario's route while an estimator runs inside; it sees the belief, not the truth.

    Action (2,), -1 to 1: steering angle in 0.6 rad (left positive), speed from 0 to `top_speed_mps`; both are reached
    at limited rates and held for `decision_snapshots` snapshots. Observation, all of it from the belief:

        belief (6,)        pose: m, rad
        std (3,)           standard deviations of x, y (m) and yaw (rad)
        route (10, 2)      the route ahead, every 4 m, in the believed body frame (m)
        motion (2,)        speed (m/s), steering angle (rad)
        to_go_m (1,)       distance left along the route

    Reward: metres of progress along the route, less `uncertainty_weight` times the claimed standard deviation of the
    position (m) per second; 20 at the goal, -20 for a collision with a building or more than `lost_m` off the route,
    which both end the episode. Cut off after `time_limit_s` (default: twice the scenario's duration).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self,
        scenario: str = "tiny",
        estimator: str = "ekf-slam",
        decision_snapshots: int = 8,
        top_speed_mps: float = 3.0,
        uncertainty_weight: float = 0.5,
        lost_m: float = 15.0,
        time_limit_s: float | None = None,
        drives: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(scenario, drives, overrides, render_mode)
        self.decision_snapshots, self.top_speed_mps = decision_snapshots, top_speed_mps
        self.uncertainty_weight, self.lost_m = uncertainty_weight, lost_m
        self._limit_s, self._name = time_limit_s, estimator
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "belief": spaces.Box(-WIDE, WIDE, dtype=np.float64),
                "std": spaces.Box(0.0, 1e6, (3,), np.float64),
                "route": spaces.Box(-1e5, 1e5, (AHEAD, 2), np.float64),
                "motion": spaces.Box(-10.0, 100.0, (2,), np.float64),
                "to_go_m": spaces.Box(0.0, 1e5, (1,), np.float64),
            }
        )

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold steering angle and speed, an action (2,) as shares of their limits in [-1, 1], for some snapshots."""
        wanted = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        steering, speed = float(wanted[0]) * STEERING_LIMIT_RAD, 0.5 * (float(wanted[1]) + 1.0) * self.top_speed_mps
        before, reason = self._arc_m, ""
        driven: list[tuple[Floats, Floats, Floats]] = []
        while not reason and len(driven) < self.decision_snapshots:
            driven.append(self._drive(steering, speed))
            reason = self._ended()
        cost = self._measure(self._now - len(driven) + 1, self._dt_s, *np.moveaxis(np.array(driven), 1, 0))
        reward = self._arc_m - before - cost
        reward += {"goal": GOAL_REWARD, "collision": CRASH_REWARD, "off the route": CRASH_REWARD}.get(reason, 0.0)
        cut = reason == "" and self._now * self._dt_s >= self._end_s
        return self._observe(), float(reward), reason != "", cut, self._info(reason)

    def _scene(self) -> tuple[Scene, Floats, Floats | None]:
        truth = Scene(self._world.scene.city, np.array(self._track), self._seen_m, self._world.sites_m, self._points)
        return truth, self._answer.pose, self._answer.covariance

    def _begin(self, seed: int, trial: int) -> None:
        from shapely import STRtree

        from cellslam.sim.vehicle import plan_route
        from cellslam.sim.vehicle.odometry import odometry_model

        config = self._scenario.world
        self._world: World = prepare(config, seed, trial)
        route = plan_route(self._world.scene.city, config.vehicle, stream(seed, trial, Stream.ROUTE))
        kept = route.arc_m <= config.vehicle.distance_m
        self._points, self._arcs = route.points_m[kept], route.arc_m[kept]
        self._walls = STRtree(list(self._world.scene.city.footprints))
        self._streams, self._rng = self._world.streams(), stream(seed, trial, Stream.ODOMETRY)
        model = self._model = odometry_model(config.odometry)
        self._scale = model.scale * self._rng.standard_normal(6)
        self._bias = model.bias * self._rng.standard_normal(6)
        start = np.array(self._world.drive.poses[0])
        start[4:] = 0.0
        vehicle = config.vehicle
        self._car = Vehicle(start, vehicle.wheelbase_m, max(vehicle.acceleration_mps2, 1.0))
        self._dt_s = vehicle.snapshot_interval_s
        self._end_s = 2.0 * vehicle.duration_s if self._limit_s is None else self._limit_s
        self._now, self._row, self._near, self._believed_near, self._arc_m = 0, 0, 0, 0, 0.0
        self._track = [start.copy()]
        setup = Setup(*known_of(self._world), model, self._world.start_pose, np.array(vehicle.start_std))
        (request,) = resolve(self._scenario.estimator, (self._name,))
        if request.oracle:
            raise InputError(f"estimator '{self._name}' needs the truth of a whole drive: choose one that does not")
        warm_up(request)
        self._estimator = request.estimator(request.options)
        self._estimator.start(setup, stream(seed, trial, Stream.ESTIMATOR))
        self._measure(0, 0.0, start[None], np.zeros((1, 6)), np.zeros((1, 6)))

    def _drive(self, steering_rad: float, speed_mps: float) -> tuple[Floats, Floats, Floats]:
        """Advance by one snapshot; return true pose, true velocity and odometry, (6,) each."""
        before, model, dt = self._car.pose.copy(), self._model, self._dt_s
        self._car.advance(steering_rad, speed_mps, dt)
        self._now += 1
        self._track.append(self._car.pose.copy())
        noise = self._rng.standard_normal((2, 6))
        self._bias = self._bias + noise[0] * np.sqrt(dt) * model.bias_walk_density
        true = mean_velocity(before, self._car.pose, dt)
        odometry = (1.0 + self._scale) * true + self._bias + noise[1] * model.noise_density / np.sqrt(dt)
        self._near = _nearest(self._points, self._car.pose, self._near)
        self._arc_m = float(self._arcs[self._near])
        return self._track[-1], true, odometry

    def _measure(self, first: int, dt_s: float, poses: Floats, velocities: Floats, odometry: Floats) -> float:
        """Let the estimator see the snapshots from `first` on, whose paths are traced together; return the cost."""
        found, paths = self._world.measure(poses, velocities, first, self._streams, odometry)
        numbers, cost = found.measurements.snapshot, 0.0
        for t, u in enumerate(odometry, first):
            rows = slice(*np.searchsorted(numbers, (t, t + 1)))
            snapshot = _snapshot(found.measurements, rows, t, self._row)
            self._row += len(snapshot)
            self._answer: Estimate = self._estimator.step(dt_s, u, snapshot)
            cov = self._answer.covariance
            cost += self.uncertainty_weight * dt_s * float(np.sqrt(max(cov[0, 0] + cov[1, 1], 0.0)))
        last = found.path[rows]
        self._seen_m = paths.vt_position_m[last[last >= 0]]
        return cost

    def _ended(self) -> str:
        from shapely import Point

        x, y = self._car.pose[:2]
        clearance = self._scenario.world.vehicle.clearance_m
        if len(self._walls.query(Point(x, y), predicate="dwithin", distance=clearance)):
            return "collision"
        if np.hypot(*(self._points[self._near] - (x, y))) > self.lost_m:
            return "off the route"
        to_goal = float(np.hypot(*(self._points[-1] - (x, y))))
        return "goal" if to_goal <= GOAL_M and self._arcs[-1] - self._arc_m <= 2.0 * GOAL_M else ""

    def _observe(self) -> Observation:
        pose, cov = np.array(self._answer.pose, np.float64), self._answer.covariance
        self._believed_near = _nearest(self._points, pose, self._believed_near)
        arc = self._arcs[self._believed_near]
        ahead = np.minimum(arc + AHEAD_STEP_M * np.arange(1, AHEAD + 1), self._arcs[-1])
        route = np.stack([np.interp(ahead, self._arcs, self._points[:, i]) for i in range(2)], axis=1) - pose[:2]
        c, s = np.cos(pose[3]), np.sin(pose[3])
        return {
            "belief": pose,
            "std": np.sqrt(np.maximum(np.diag(cov)[[0, 1, 3]], 0.0)),
            "route": route @ np.array([[c, -s], [s, c]]),
            "motion": np.array([self._car.speed_mps, self._car.steering_rad]),
            "to_go_m": np.array([self._arcs[-1] - arc]),
        }

    def _info(self, reason: str = "") -> dict[str, Any]:
        error = self._answer.pose[:2] - self._car.pose[:2]
        return {
            "truth_pose": self._car.pose.copy(),
            "position_error_m": float(np.hypot(error[0], error[1])),
            "progress_m": self._arc_m,
            "time_s": self._now * self._dt_s,
            "ended": reason,
        }


def _nearest(points_m: Floats, pose: Floats, from_index: int) -> int:
    """Return the nearest point of a route, near the last one: a route may cross itself."""
    low, high = max(from_index - WINDOW, 0), min(from_index + WINDOW + 1, len(points_m))
    return low + int(np.argmin(np.sum((points_m[low:high] - pose[:2]) ** 2, axis=1)))


def _snapshot(m: Measurements, rows: slice, index: int, first_row: int) -> Snapshot:
    numbers = np.arange(first_row, first_row + rows.stop - rows.start)
    columns: dict[str, Any] = {name: getattr(m, name) for name in ("link", *COLUMNS)}
    shown = {name: column[rows] for name, column in columns.items() if column is not None}
    return Snapshot(index, numbers, **shown)
