"""`cellslam/Localization-v0`: from the odometry and paths of one snapshot to a believed pose increment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium import spaces

from cellslam.benchmarks.env.scenario_env import Observation, ScenarioEnv, Scene
from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.simulation import simulate
from cellslam.sim.frames import integrate_pose, mean_velocity
from cellslam.sim.recording import Floats, Measurements, OdometryModel, Recording
from cellslam.slam.api import Setup, Snapshot, odometry_of, setup_of, snapshots_of

DEVIATIONS = ("distance_std_m", "azimuth_std_rad", "elevation_std_rad")
COLUMNS = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db", *DEVIATIONS)
LOWEST = np.array([-1e6, -4.0, -2.0, -300.0, 0.0, 0.0, 0.0])
HIGHEST = np.array([1e6, 4.0, 2.0, 300.0, 1e6, 1e3, 1e3])
REACH = 2.0  # deviations of the odometry's error that an action of 1 corrects
LEAST_UNIT = np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])  # m and rad, where the odometry has no error
KEPT_RECORDINGS = 8


@lru_cache(maxsize=KEPT_RECORDINGS)
def _recording(scenario: str, seed: int, trial: int) -> Recording:
    """Return a trial's recording in a resolved scenario as JSON; meeting one again costs nothing."""
    return simulate(from_tables(json.loads(scenario)), seed, trial)


def action_unit(model: OdometryModel, dt_s: float | Floats, odometry: Floats) -> Floats:
    """Return what an action of 1 adds to the odometry, (6,) in m and rad: REACH deviations of its error over dt_s.

    odometry (6,) in m/s and rad/s; or for many intervals at once odometry (T, 6) and dt_s (T, 1).
    """
    constant = np.hypot(model.bias, model.scale * odometry) * dt_s
    return np.asarray(np.maximum(REACH * np.hypot(model.noise_density * np.sqrt(dt_s), constant), LEAST_UNIT))


def compose(pose: Floats, seen: Observation, action: Floats) -> Floats:
    """Return the pose (6,), in m and rad, after the interval seen, with an action (6,) added to the odometry."""
    return integrate_pose(pose, seen["odometry"] * seen["dt_s"] + action * seen["unit"], 1.0)


def action_between(before: Floats, seen: Observation, after: Floats) -> Floats:
    """Return the action (6,) that takes pose `before` to `after`, (6,) in m and rad: the inverse of `compose`."""
    action: Floats = (mean_velocity(before, after, 1.0) - seen["odometry"] * seen["dt_s"]) / seen["unit"]
    return action


class LocalizationEnv(ScenarioEnv):
    """An episode is a drive: step t takes the pose increment that the agent believes in, up to snapshot t.

    Action (6,), -1 to 1: what is added to the odometry's increment, forward, left, up, yaw, pitch, roll, in `unit`s;
    0 believes the odometry. One beyond that range is taken as it is. The first one is about snapshot 0, from the start
    pose. Observation:

        dt_s (1,)                  s since the snapshot before it
        odometry (6,)              mean body velocities, m/s and rad/s
        unit (6,)                  two deviations of the odometry's error since then, m and rad
        paths (max_paths, 7)       distance_m, azimuth_rad, elevation_rad, snr_db, claimed deviations (m, rad, rad)
        measured (max_paths, 7)    1 where that component was measured; 0 elsewhere, and the value is 0
        link (max_paths,)          link of each path
        mask (max_paths,)          1 where there is a path; paths beyond max_paths are dropped, the weakest first
        last_action (6,)

    Reward: minus the horizontal position error in metres. Truth is in `info` alone. `reset(seed=...)` chooses the
    drive; `reset(options={...})`: "scenario" (preset or .toml path), "set" (overrides by dotted key), "seed" and
    "trial" (the drive of `cellslam run --seed`). `drives`: number of different drives to choose from (None: any).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 13}  # noqa: RUF012

    def __init__(
        self,
        scenario: str = "tiny",
        max_paths: int = 128,
        drives: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(scenario, drives, overrides, render_mode)
        self.max_paths = max_paths
        self.belief: Floats = np.zeros(6)
        self.belief_covariance: Floats | None = None
        self._now = 0
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (6,), np.float32)
        wide = (max_paths, len(COLUMNS))
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "dt_s": spaces.Box(0.0, 1e4, (1,), np.float64),
                "odometry": spaces.Box(-1e3, 1e3, (6,), np.float64),
                "unit": spaces.Box(0.0, 1e5, (6,), np.float64),
                "paths": spaces.Box(
                    np.tile(LOWEST, (max_paths, 1)), np.tile(HIGHEST, (max_paths, 1)), dtype=np.float64
                ),
                "measured": spaces.Box(0, 1, wide, np.int8),
                "link": spaces.Box(0, 100_000, (max_paths,), np.int64),
                "mask": spaces.Box(0, 1, (max_paths,), np.int8),
                "last_action": spaces.Box(-1e9, 1e9, (6,), np.float64),
            }
        )

    @property
    def setup(self) -> Setup:
        """What an estimator may know before the drive."""
        return self._setup

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Add an action (6,) to the odometry's increment up to the present snapshot, and go on to the next."""
        self._action = np.array(action, np.float64)
        self.belief = compose(self.belief, self._seen, self._action)
        truth = self._truth.poses[self._now]
        error = float(np.hypot(self.belief[0] - truth[0], self.belief[1] - truth[1]))
        self._errors.append(error)
        info = self._info()
        ended = self._now == len(self._snapshots) - 1
        if not ended:
            self._now += 1
        return self._observe(), -error, ended, False, info

    def _scene(self) -> tuple[Scene, Floats, Floats | None]:
        from cellslam.sim.world import prepare

        recording, now, truth = self._recording, max(len(self._errors) - 1, 0), self._truth
        city = prepare(self._scenario.world, *self._drive).scene.city
        seen = truth.measurement_vt[slice(*recording.rows[now : now + 2])]
        vts_m = truth.vts.position_m[np.unique(seen[seen >= 0])]
        return Scene(city, truth.poses[: now + 1], vts_m, truth.site_positions_m), self.belief, self.belief_covariance

    def _begin(self, seed: int, trial: int) -> None:
        self._drive = seed, trial
        recording = self._recording = _recording(json.dumps(self._scenario.resolved, sort_keys=True), seed, trial)
        assert recording.truth is not None
        self._truth, self._setup, self._snapshots = recording.truth, setup_of(recording), snapshots_of(recording)
        self._odometry, self._dt_s = odometry_of(recording), np.diff(recording.time_s, prepend=recording.time_s[0])
        self.belief, self.belief_covariance = np.array(recording.start_pose), None
        self._now, self._action = 0, np.zeros(6)
        self._errors: list[float] = []

    def _observe(self) -> Observation:
        dt_s, odometry = float(self._dt_s[self._now]), self._odometry[self._now]
        unit = action_unit(self._setup.odometry_model, dt_s, odometry)
        self._seen = observation(self._snapshots[self._now], dt_s, odometry, unit, self._action, self.max_paths)
        return {name: value.copy() for name, value in self._seen.items()}

    def _info(self) -> dict[str, Any]:
        truth = self._truth.poses[self._now]
        return {
            "truth_pose": truth.copy(),
            "belief_pose": self.belief.copy(),
            "start_pose": np.array(self._recording.start_pose),
            "position_error_m": self._errors[-1] if self._errors else 0.0,
            "snapshot": self._now,
        }


def observation(
    snapshot: Snapshot, dt_s: float, odometry: Floats, unit: Floats, last_action: Floats, max_paths: int
) -> Observation:
    """Return a snapshot as padded arrays (max_paths, ...); where it has more paths, the strongest in their order.

    dt_s in s; odometry (6,) in m/s and rad/s; unit (6,) of an action in m and rad; last_action (6,) in its units.
    """
    table, link = path_table(snapshot), snapshot.link
    if len(table) > max_paths:
        strongest = np.sort(np.argsort(-np.nan_to_num(table[:, 3], nan=-np.inf), kind="stable")[:max_paths])
        table, link = table[strongest], link[strongest]
    there, count = ~np.isnan(table), len(table)
    out: Observation = {
        "dt_s": np.array([dt_s]),
        "odometry": np.array(odometry),
        "unit": np.array(unit),
        "paths": np.zeros((max_paths, len(COLUMNS))),
        "measured": np.zeros((max_paths, len(COLUMNS)), np.int8),
        "link": np.zeros(max_paths, np.int64),
        "mask": np.zeros(max_paths, np.int8),
        "last_action": last_action.copy(),
    }
    out["paths"][:count] = np.where(there, table, 0.0)
    out["measured"][:count], out["link"][:count], out["mask"][:count] = there, link, 1
    return out


def path_table(paths: Snapshot | Measurements) -> Floats:
    """Return the columns of n paths as a table (n, 7), NaN where a component was not measured."""
    columns = (getattr(paths, name) for name in COLUMNS)
    return np.stack([np.full(len(paths), np.nan) if one is None else one for one in columns], axis=1)


def snapshot_of(observed: Observation, index: int, first_row: int) -> Snapshot:
    """Return the snapshot that an observation shows: the inverse of `observation`."""
    count = int(observed["mask"].sum())
    table: Floats = np.where(observed["measured"][:count] > 0, observed["paths"][:count], np.nan)
    values = [np.ascontiguousarray(column) for column in table.T]
    claimed = [None if np.isnan(v).all() and count else v for v in values[4:]]
    for column in values:
        column.setflags(write=False)
    rows = np.arange(first_row, first_row + count)
    link = np.array(observed["link"][:count])
    return Snapshot(index, rows, link, *values[:4], *claimed)
