"""`cellslam/Localization-v0`, many episodes at once: steps are whole-array operations on drives that lie in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cellslam.benchmarks.env.localization import action_unit, path_table
from cellslam.benchmarks.env.observation_kernel import Drives, write_observations
from cellslam.scenarios.loading import load
from cellslam.scenarios.sets.reading import drives_of
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.api import odometry_of

Floats32 = NDArray[np.float32]
Arrays = tuple[Floats32, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]
DRIVES = 16  # that are simulated where no number is asked for


class LocalizationVectorEnv(VectorEnv[Any, Any, Any]):
    """`num_envs` episodes of `cellslam/Localization-v0` at once, each over a drive drawn from the same drives.

    Observations (N, 19 + 16 max_paths) are those of `LocalizationEnv`, flat as `FlattenObservation` makes them, in 32
    bits; actions (N, 6), rewards, and `info` are its own, with a row an episode. An episode that has ended begins again
    in the next step, whose action it does not see and whose reward is 0. Drives: trial 0 of seeds 0 to `drives` - 1 in
    a scenario, as the single environment's with `drives`; or the first `drives` (None: all) of a split of the set in
    `folder`. `copy`: observations are the caller's own; without it the next step writes over them. Raises InputError.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str = "tiny",
        max_paths: int = 128,
        drives: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
        split: str = "train",
        copy: bool = True,
    ) -> None:
        if folder is None:
            chosen = load(scenario, overrides)
            recordings = [simulate(chosen, seed) for seed in range(DRIVES if drives is None else drives)]
        else:
            recordings = [Recording.load(drive.path) for drive in drives_of(folder, split)[:drives]]
        truth = [one.truth.poses for one in recordings if one.truth is not None]
        if not recordings or len(truth) < len(recordings):
            raise InputError(f"{folder}, '{split}': an episode needs a drive with its truth")
        self.num_envs, self.max_paths, self._copy = num_envs, max_paths, copy
        self.single_observation_space = spaces.Box(-1e9, 1e9, (19 + 16 * max_paths,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._drives, self._truth = joined(recordings), np.concatenate(truth)
        self._start = np.array([one.start_pose for one in recordings])
        lengths = np.array([len(one.time_s) for one in recordings])
        self._first, self._last = np.cumsum(lengths) - lengths, np.cumsum(lengths) - 1
        self._seen: Floats32 = np.zeros((num_envs, 19 + 16 * max_paths), np.float32)
        self._action: Floats32 = np.zeros((num_envs, 6), np.float32)
        self._pose, self._error = np.zeros((num_envs, 6)), np.zeros(num_envs)
        self._drive: Ints = np.zeros(num_envs, np.int64)
        self._at, self._over = self._drive.copy(), np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin all episodes; the same seed draws the same drives."""
        super().reset(seed=seed)
        self._over[:] = False
        if options:
            raise InputError("reset of the vector environment has no options: the drives are chosen when it is made")
        self._begin(np.ones(self.num_envs, np.bool_))
        return self._observe(), self._info()

    def step(self, actions: Floats32) -> Arrays:
        """Add actions (N, 6) to the odometry's increments up to the present snapshots, and go on to the next ones."""
        self._action[:] = actions
        self._begin(self._over)
        going, at = np.logical_not(self._over), self._at
        moved = self._drives.odometry[at] * self._drives.dt_s[at, None] + self._action * self._drives.unit[at]
        self._pose[going] = integrate_pose(self._pose[going], moved[going], np.ones(1))
        off = self._pose[:, :2] - self._truth[at, :2]
        self._error = np.where(going, np.hypot(off[:, 0], off[:, 1]), 0.0)
        info, self._over = self._info(), going & (at == self._last[self._drive])
        self._at = at + (going & ~self._over)
        return self._observe(), -self._error, self._over.copy(), np.zeros(self.num_envs, np.bool_), info

    def _begin(self, which: NDArray[np.bool_]) -> None:
        """Put the episodes `which` (N,) at the start of a drive each."""
        self._drive[which] = self.np_random.integers(len(self._first), size=int(which.sum()))
        drive = self._drive[which]
        self._at[which], self._pose[which], self._action[which] = self._first[drive], self._start[drive], 0.0
        self._error[which] = 0.0

    def _observe(self) -> Floats32:
        write_observations(self._seen, self._at, self._action, self.max_paths, self._drives)
        return self._seen.copy() if self._copy else self._seen

    def _info(self) -> dict[str, Any]:
        return {
            "truth_pose": self._truth[self._at], "belief_pose": self._pose.copy(),
            "start_pose": self._start[self._drive], "position_error_m": self._error.copy(),
            "snapshot": self._at - self._first[self._drive],
        }  # fmt: skip


def joined(recordings: Sequence[Recording]) -> Drives:
    """Return recordings one after the other, in 32 bits."""
    dt_s = [np.diff(one.time_s, prepend=one.time_s[0]) for one in recordings]
    odometry = [odometry_of(one) for one in recordings]
    unit = [
        action_unit(one.odometry_model, dt[:, None], u) for one, dt, u in zip(recordings, dt_s, odometry, strict=True)
    ]
    counts = np.concatenate([np.diff(one.rows) for one in recordings])
    paths = [path_table(one.measurements) for one in recordings]
    link = np.concatenate([one.measurements.link for one in recordings]).astype(np.float32)
    dt, u, unit_, path = (np.concatenate(parts).astype(np.float32) for parts in (dt_s, odometry, unit, paths))
    return Drives(np.concatenate([[0], np.cumsum(counts)]), dt, u, unit_, path, link)
