"""The true drive: poses of the array at the snapshots, and instantaneous body velocities.

A kinematic bicycle follows the route (`follower_kernel`) at the speeds of `speed_profile`; its body pitches, rolls and
heaves on its suspension and on an uneven road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.frames import world_to_body, wrap_angle
from cellslam.sim.recording import Floats
from cellslam.sim.vehicle.route import Route
from cellslam.sim.vehicle.speed_profile import speed_profile
from cellslam.sim.vehicle.vehicle_config import VehicleConfig

LONGEST_SUBSTEP_S = 0.015
WAVES = 32


@dataclass(frozen=True, repr=False)
class Drive(Described):
    """What the vehicle did: `time_s` (T,); `poses` (T, 6) of the array's phase centre; `velocity` (T, 6).

    The velocities are instantaneous: three in the body frame (m/s), then yaw, pitch and roll rates (rad/s).
    The array sits above the rear axle, where the bicycle has no lateral velocity.
    """

    time_s: Floats
    poses: Floats
    velocity: Floats

    @property
    def distance_m(self) -> float:
        """Horizontal distance driven."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def drive(route: Route, config: VehicleConfig, rng: np.random.Generator) -> Drive:
    """Return a drive of `config.distance_m` along `route` in `config.duration_s`, as T snapshots.

    Raises InputError where distance and duration do not go together, or the route is too short.
    """
    if route.length_m < config.distance_m:
        raise InputError(
            f"the route is {route.length_m:.1f} m long, vehicle.distance_m = {config.distance_m:g} is longer"
        )
    if config.snapshots < 2:
        raise InputError(
            f"vehicle.duration_s = {config.duration_s:g} holds fewer than two snapshot intervals: lengthen it"
        )
    per_snapshot = int(np.ceil(config.snapshot_interval_s / LONGEST_SUBSTEP_S))
    step_s = config.snapshot_interval_s / per_snapshot
    steps = (config.snapshots - 1) * per_snapshot
    speed = speed_profile(route.arc_m, route.curvature_per_m, config, step_s, steps, rng)
    poses, rates = _motion(route, speed, step_s, config, rng)
    velocity = np.concatenate([world_to_body(poses, rates[:, :3]), rates[:, 3:]], axis=1)
    poses[:, 3:] = wrap_angle(poses[:, 3:])
    time_s = np.arange(config.snapshots, dtype=np.float64) * config.snapshot_interval_s
    return Drive(time_s, poses[::per_snapshot].copy(), velocity[::per_snapshot].copy())


def _motion(
    route: Route, speed_mps: Floats, step_s: float, config: VehicleConfig, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return poses (N + 1, 6) and their time derivatives (N + 1, 6) in the world at every substep."""
    from cellslam.sim.vehicle.follower_kernel import follow

    start = np.array([*route.points_m[0], route.heading_rad[0]])
    plane, curvature = follow(route.points_m, route.arc_m, start, speed_mps, step_s, config.wheelbase_m)
    arc_m = np.concatenate([[0.0], np.cumsum(speed_mps * step_s)])
    v = _at_edges(speed_mps)
    turn_rate = v * _at_edges(curvature)
    body = _body_motion(arc_m, v, turn_rate, step_s, config, rng)
    height = route.ground_m + config.array_height_m + body[:, 0]
    poses = np.column_stack([plane[:, :2], height, plane[:, 2], body[:, 1:]])
    body_rate = np.gradient(body, step_s, axis=0)
    yaw = plane[:, 2]
    rates = np.column_stack([v * np.cos(yaw), v * np.sin(yaw), body_rate[:, 0], turn_rate, body_rate[:, 1:]])
    return poses, rates


def _at_edges(of_steps: Floats) -> Floats:
    """Return values (N + 1,) at the substeps' edges from their means (N,)."""
    return np.concatenate([of_steps[:1], 0.5 * (of_steps[1:] + of_steps[:-1]), of_steps[-1:]])


def _body_motion(
    arc_m: Floats, speed_mps: Floats, turn_rate_radps: Floats, step_s: float, config: VehicleConfig,
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Return height above the start's ground in m, pitch and roll in rad, (N, 3), at equidistant times.

    Braking puts the nose down (positive pitch), a left turn leans the body outward (positive roll); the pitch follows
    the road under the wheels. The attitude turns about the array's phase centre. Height and roll of the road are
    random, smooth functions of the arc length s with the correlation exp(-(s / road_correlation_m)^2 / 2): sums of
    `WAVES` cosines.
    """
    wavenumber = rng.normal(0.0, 1.0 / config.road_correlation_m, (2, WAVES))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))

    def faded_in(s: Floats) -> Floats:
        """Return the share of the unevenness at s: a drive starts on level ground."""
        return np.asarray(-np.expm1(-0.5 * (s / config.road_correlation_m) ** 2))

    def uneven(which: int, s: Floats) -> Floats:
        total: Floats = np.zeros_like(s)
        for k, own in zip(wavenumber[which], phase[which], strict=True):
            total += np.cos(k * s + own)
        return np.asarray(total * faded_in(s) * np.sqrt(2.0 / WAVES))

    grade, uneven_m = config.road_slope_percent / 100.0, config.road_height_std_m * uneven(0, arc_m)
    ahead_m = config.road_height_std_m * uneven(0, arc_m + config.wheelbase_m)
    # The road under both axles counts as level at the start.
    slope = grade + (ahead_m - uneven_m) / config.wheelbase_m * faded_in(arc_m)
    acceleration = np.gradient(speed_mps, step_s)
    pitch = -np.arctan(slope) - np.radians(config.pitch_gradient_deg_per_mps2) * acceleration
    roll = float(np.radians(config.road_roll_std_deg)) * uneven(1, arc_m)
    roll = roll + np.radians(config.roll_gradient_deg_per_mps2) * (speed_mps * turn_rate_radps)
    return np.column_stack([uneven_m + grade * arc_m, pitch, roll])
