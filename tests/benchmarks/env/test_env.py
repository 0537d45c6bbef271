"""The gymnasium environments: checked, seeded, vectorised, fast; estimators and agents change places."""

from __future__ import annotations

import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cellslam.benchmarks.env
from cellslam.benchmarks.env.adapters import AgentEstimator, EstimatorAgent
from cellslam.benchmarks.env.localization import REACH, LocalizationEnv, action_unit, observation, snapshot_of
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings.sets.making import finish, make
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.sets import SETS
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.randomness import Stream, stream
from cellslam.slam.api import snapshots_of
from cellslam.slam.conformance.subject import tiny_drive
from tests.short_drive import SET

NAME, ACTIVE = cellslam.benchmarks.env.LOCALIZATION, cellslam.benchmarks.env.ACTIVE_SLAM


def made(**words: Any) -> Any:
    return gym.make(NAME, **words).unwrapped


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAME, f"cellslam.benchmarks.env:{ACTIVE}"])
def test_passes_the_checker_without_warnings(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(name, drives=1, render_mode="rgb_array").unwrapped)


def test_same_seed_same_episode() -> None:
    env, seen = made(drives=4), []
    for seed in (3, 3, None):
        states = [env.reset(seed=seed)[0], *(env.step(np.full(6, 1e-4))[0] for _ in range(5))]
        seen.append(np.concatenate([np.ravel(v) for s in states for v in s.values()]))
    np.testing.assert_array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2])


def test_observation_holds_a_snapshot_exactly_or_its_strongest_paths() -> None:
    for t, snapshot in enumerate(snapshots_of(tiny_drive())[:50]):
        back = snapshot_of(observation(snapshot, 0.1, *np.zeros((3, 6)), 64), t, int(snapshot.row[0]))
        for name, value in vars(snapshot).items():
            np.testing.assert_array_equal(getattr(back, name), value, err_msg=name)
        few = observation(snapshot, 0.1, *np.zeros((3, 6)), 5)
        np.testing.assert_array_equal(np.sort(few["paths"][few["mask"] > 0, 3]), np.sort(snapshot.snr_db)[-5:])


def test_truth_is_in_info_alone_and_rewards_are_errors() -> None:
    env = made(drives=1)
    seen, info = env.reset(seed=0)
    np.testing.assert_array_equal(info["start_pose"], info["truth_pose"])
    _, reward, ended, cut, info = env.step(np.array([3.0, 4.0, 0, 0, 0, 0]) / seen["unit"])
    assert (reward, info["position_error_m"]) == pytest.approx((-5.0, 5.0))
    assert not (ended or cut)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf-slam", "dead-reckoning"])
def test_estimator_in_the_environment_is_the_estimator_of_run(name: str) -> None:
    scenario = load("tiny", SET)
    (request,) = resolve(scenario.estimator, (name,))
    expected = estimate(simulate(scenario, 11, 0), request, stream(11, 0, Stream.ESTIMATOR))
    env = made()
    seen, _ = env.reset(options={"scenario": "tiny", "seed": 11, "set": SET})
    agent = EstimatorAgent(request.estimator(request.options), env.setup, stream(11, 0, Stream.ESTIMATOR))
    ended = False
    while not ended:
        seen, _, ended, _, info = env.step(agent(seen))
    np.testing.assert_array_equal(np.array(agent.poses), expected.poses)
    np.testing.assert_allclose(info["belief_pose"], expected.poses[-1], atol=1e-9)
    assert len(agent.poses) == info["snapshot"] + 1


class Wheels(AgentEstimator):
    """An agent that believes the odometry."""

    def policy(self) -> Any:
        return lambda seen: np.zeros(6)


def test_agent_can_be_scored_as_an_estimator() -> None:
    recording = tiny_drive()
    (reference,) = resolve({}, ("dead-reckoning",))
    both = (Request("wheels", Wheels, None), reference)
    poses = [estimate(recording, request, np.random.default_rng(0)).poses for request in both]
    np.testing.assert_allclose(*poses, atol=1e-9)


def test_an_action_is_counted_in_deviations_of_the_odometry() -> None:
    rng, dt, speed, count = np.random.default_rng(4), 0.1, np.array([3.0, 0.0, 0.0, 0.2, 0.0, 0.0]), 20_000
    model = tiny_drive().odometry_model
    sizes = (model.bias, model.scale, model.noise_density)
    bias, scale, white = (rng.standard_normal((count, 6)) * size for size in sizes)
    error = (bias + scale * speed) * dt + white * np.sqrt(dt)
    unit = action_unit(model, dt, speed)
    there = error.std(axis=0) > 0.0
    assert there.sum() >= 2
    np.testing.assert_allclose(unit[there], REACH * error.std(axis=0)[there], rtol=0.02)
    assert (unit > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mode", "key", "shape"),
    [
        (NAME, "sync", "paths", (2, 128, 7)),
        (NAME, "async", "paths", (2, 128, 7)),
        (ACTIVE, "sync", "route", (2, 10, 2)),
    ],
)
def test_vectorises(name: str, mode: Any, key: str, shape: tuple[int, ...]) -> None:
    spawn = {"context": "spawn"} if mode == "async" else {}
    with closing(gym.make_vec(name, num_envs=2, vectorization_mode=mode, vector_kwargs=spawn, drives=2)) as vector:
        seen, _ = vector.reset(seed=[1, 2])
        assert seen[key].shape == shape
        _, rewards, *_ = vector.step(np.zeros(vector.action_space.shape))
        assert rewards.shape == (2,)


def pursuit(seen: Any) -> Any:
    """Steer towards the route 8 m ahead, at half the top speed."""
    x, y = seen["route"][1]
    return np.array([np.clip(np.arctan2(2.0 * 2.9 * y, x * x + y * y) / 0.6, -1, 1), 0.0])


@pytest.mark.slow
def test_a_planner_arrives() -> None:
    env, sums = gym.make(ACTIVE, drives=1, render_mode="rgb_array").unwrapped, []
    for _ in range(2):
        seen, _ = env.reset(seed=5)
        total, ended, cut = 0.0, False, False
        while not (ended or cut):
            seen, reward, ended, cut, info = env.step(pursuit(seen))
            total += reward
        assert info["ended"] == "goal" and info["position_error_m"] < 3.0
        sums.append(total)
    assert sums[0] == sums[1] and 20.0 < sums[0] < 60.0
    assert len(np.unique(env.render().reshape(-1, 3), axis=0)) > 20


@pytest.mark.parametrize(
    ("action", "words", "reason"),
    [([1.0, 1.0], {"lost_m": 6.0, "top_speed_mps": 6.0}, "off the route"), ([0.0, -1.0], {"time_limit_s": 3.0}, "")],
)
def test_who_goes_astray_or_stands_is_stopped(action: list[float], words: dict[str, Any], reason: str) -> None:
    env: Any = gym.make(ACTIVE, estimator="dead-reckoning", drives=1, **words).unwrapped
    env.reset(seed=5)
    for _ in range(200):
        _, reward, ended, cut, info = env.step(np.array(action))
        if ended or cut:
            break
    assert info["ended"] == reason
    assert ended == (not cut) == (reward < -15) == bool(reason)


def test_collisions_end_the_drive() -> None:
    env: Any = gym.make(ACTIVE, estimator="dead-reckoning", drives=1).unwrapped
    env.reset(seed=5)
    env._car.pose[:2] = np.array(env._world.scene.city.footprints[0].exterior.coords[0]) + 0.5
    _, reward, ended, _, info = env.step(np.array([0.0, -1.0]))
    assert ended and info["ended"] == "collision" and reward < 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"scnario": "tiny"}, "did you mean 'scenario'"),
        ({"scenario": "tny"}, "did you mean 'tiny'"),
        ({"set": {"radio.clutter": 1.0}}, "unknown key"),
    ],
)
def test_wrong_options_are_explained(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        made().reset(options=options)


def test_wrong_render_mode_is_explained() -> None:
    with pytest.raises(InputError, match="rgb_array"):
        LocalizationEnv(render_mode="human")


@pytest.mark.slow
def test_many_episodes_at_once_are_the_single_ones() -> None:
    """Observations, rewards and infos of each, to 32 bits, over two drives each, with fewer paths shown than are."""
    many: Any = gym.make_vec(NAME, num_envs=3, drives=2, max_paths=12)
    singles = [gym.wrappers.FlattenObservation(made(max_paths=12)) for _ in range(3)]
    seen, info = many.reset(seed=5)
    assert many.observation_space.contains(seen)
    rng, over, drives = np.random.default_rng(0), np.ones(3, bool), set()
    for _ in range(2):
        assert over.all()
        for k, one in enumerate(singles):
            expected, single = one.reset(options={"seed": int(many._drive[k])})
            np.testing.assert_allclose(seen[k], expected, rtol=1e-6)
            np.testing.assert_array_equal(info["truth_pose"][k], single["truth_pose"])
        drives.update(many._drive)
        for _ in range(400):
            action = rng.normal(size=(3, 6)).astype(np.float32)
            seen, reward, over, cut, info = many.step(action)
            for k, one in enumerate(singles):
                expected, value, ended, _, single = one.step(action[k])
                if not ended:
                    np.testing.assert_allclose(seen[k], expected, rtol=2e-5, atol=1e-6)
                np.testing.assert_allclose(info["belief_pose"][k], single["belief_pose"], atol=1e-3)
                assert (reward[k], over[k]) == (pytest.approx(value, abs=1e-3), ended)
            if over.any():
                break
        seen, reward, _, cut, info = many.step(action)  # which it does not see
        assert not reward.any() and not cut.any()
    assert drives == {0, 1}


def test_a_split_of_a_set_is_driven_but_not_one_without_truth(tmp_path: Path) -> None:
    one = replace(SETS["learn-lund"], preset="tiny", overrides={}, drives={"train": 2, "validation": 0, "test": 1})
    list(make(one, tmp_path))
    assert finish(one, tmp_path)
    many: Any = gym.make_vec(NAME, num_envs=4, folder=tmp_path, split="train")
    many.reset(seed=0)
    _, reward, _, _, info = many.step(np.zeros((4, 6)))
    np.testing.assert_allclose(-reward, info["position_error_m"])
    with pytest.raises(InputError, match="needs a drive with its truth"):
        gym.make_vec(NAME, num_envs=4, folder=tmp_path, split="test")


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAME, ACTIVE])
def test_flattened_environments_pass_the_checker_of_stable_baselines3_without_warnings(name: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="stable-baselines3 is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gym.wrappers.FlattenObservation(gym.make(name, drives=1)))
