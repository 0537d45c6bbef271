"""Small made-up worlds whose paths are mirrored by walls and scattered by points, in any proportion, or are random."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.frames import azimuth_elevation, mean_velocity, world_to_body, wrap_angle
from cellslam.sim.recording import Floats, Links, Measurements, OdometryModel, Recording, Reference, Sites
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS

STEP_S, SPEED_M_S, DETECTED, SEEN_S = 0.5, 1.0, 0.85, 40.0
NOISE = np.array([0.15, np.radians(1.5), np.radians(1.5)])  # of distance, azimuth, elevation
ODOMETRY = np.array([0.05, 0.0, 0.0, np.radians(1.5), 0.0, 0.0])
TRANSMITTER = np.array([4.0, 11.0, 3.0])
HALL = np.array([[-20.0, -15.0, 0.5], [20.0, 15.0, 6.0]])
WHITE: dict[str, Any] = {
    **NOTHING_PERSISTS, "noise_unit_snr_m": 0.0, "noise_unit_snr_azimuth_deg": 0.0, "noise_unit_snr_elevation_deg": 0.0,
    "noise_floor_m": 0.15, "noise_floor_azimuth_deg": 1.5, "noise_floor_elevation_deg": 1.5, "merge_rate": 0.0,
    "pitch_deg": 0.0, "roll_deg": 0.0,
}  # fmt: skip


class World(NamedTuple):
    """A drive through a hall, and the truth: `features` (n, 3), mirror images or scatterers by `scatters` (n,), the
    first one the transmitter; `of` (m,): the feature of each measurement, -1 for a random one."""

    recording: Recording
    poses: Floats
    features: Floats
    scatters: Any
    of: Any

    def rmse_m(self, estimates: Any) -> float:
        """Return the root mean square error of estimated places."""
        error = np.array([one.pose[:2] for one in estimates]) - self.poses[:, :2]
        return float(np.sqrt((error**2).sum(axis=1).mean()))


def world(
    seed: int,
    share: float,
    features: int = 40,
    steps: int = 400,
    known: bool = False,
    random: int = 0,
    noise: float = 1.0,
) -> World:
    """Return a world of so many features, a `share` of which are scatterers, and so many `random` paths a snapshot.

    `known`: the transmitter is surveyed.
    """
    rng = np.random.default_rng(seed)
    poses = _poses(steps)
    scatters = np.arange(features) < round(share * features)
    walls = rng.uniform(0.0, 2.0 * np.pi, features), rng.uniform(14.0, 35.0, features)
    normal = np.stack([np.cos(walls[0]), np.sin(walls[0]), np.zeros(features)], axis=1)
    images = TRANSMITTER + 2.0 * (walls[1] - normal @ TRANSMITTER)[:, None] * normal
    places = np.where(scatters[:, None], rng.uniform(*HALL, (features, 3)), images)
    places, scatters = np.vstack([TRANSMITTER, places]), np.append(False, scatters)
    begin = rng.uniform(-SEEN_S, steps * STEP_S, (features + 1, 3))  # three spans in which each is seen
    times = STEP_S * np.arange(steps)
    rows, of, z = [], [], []
    for t, pose in enumerate(poses):
        seen = ((times[t] >= begin) & (times[t] < begin + SEEN_S)).any(axis=1) & (rng.random(features + 1) < DETECTED)
        seen[0] = rng.random() < DETECTED
        which = np.flatnonzero(seen)
        z.append(_measured(pose, places[which], scatters[which]) + noise * NOISE * rng.standard_normal((len(which), 3)))
        away = np.linalg.norm(pose[:3] - TRANSMITTER) + rng.exponential(15.0, random)
        z.append(np.column_stack([away, rng.uniform(-np.pi, np.pi, random), rng.normal(0.0, 0.2, random)]))
        of += [which, np.full(random, -1)]
        rows.append(np.full(len(which) + random, t))
    z, none = np.concatenate(z), np.zeros(1, np.int64)
    survey = {"position_m": TRANSMITTER[None], "position_std_m": np.zeros((1, 3))} if known else {}
    recording = Recording(
        times, _odometry(poses, rng), OdometryModel(ODOMETRY, *np.zeros((3, 6))), Links(none, none, none),
        Sites(("A",), np.zeros(1), np.zeros(1), **survey),
        Measurements(np.concatenate(rows), np.zeros(len(z), np.int64), z[:, 0], wrap_angle(z[:, 1]),
                     np.clip(z[:, 2], -1.5, 1.5), np.full(len(z), np.nan)),
        poses[0], np.zeros(6), scatterers=True,
        reference=Reference(times, poses[:, :3], poses[:, 3], np.full(steps, 0.01)),
    )  # fmt: skip
    return World(recording, poses, places, scatters, np.concatenate(of))


def _poses(steps: int) -> Floats:
    """Return poses (T, 6) along an eight."""
    angle = SPEED_M_S * STEP_S / 9.0 * np.arange(steps)
    out = np.zeros((steps, 6))
    out[:, 0], out[:, 1], out[:, 2] = 11.0 * np.sin(0.7 * angle), 6.0 * np.sin(1.4 * angle + 0.3), 1.5
    step = np.diff(out[:, :2], axis=0, append=out[-1:, :2] + (out[-1:, :2] - out[-2:-1, :2]))
    out[:, 3] = np.arctan2(step[:, 1], step[:, 0])
    return out


def _odometry(poses: Floats, rng: np.random.Generator) -> Floats:
    """Return body velocities (T, 6) with noise."""
    out = np.zeros((len(poses), 6))
    out[1:] = mean_velocity(poses[:-1], poses[1:], STEP_S)
    return out + ODOMETRY / np.sqrt(STEP_S) * rng.standard_normal(out.shape)


def _measured(pose: Floats, places: Floats, scatters: Any) -> Floats:
    """Return distance, azimuth and elevation (n, 3) of features from a pose."""
    body = world_to_body(pose, places - pose[:3])
    excess = np.where(scatters, np.linalg.norm(places - TRANSMITTER, axis=1), 0.0)
    return np.column_stack([np.linalg.norm(body, axis=1) + excess, *azimuth_elevation(body)])
