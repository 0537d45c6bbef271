"""The gymnasium environments: checked, seeded, vectorised, fast; estimators and agents change places."""

from __future__ import annotations

import time
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cellslam.benchmarks.env
from cellslam.benchmarks.env_adapters import AgentEstimator, EstimatorAgent
from cellslam.benchmarks.env_localization import ACTION_UNIT, LocalizationEnv, observation, snapshot_of
from cellslam.benchmarks.estimation import estimate, warm_up
from cellslam.benchmarks.trials import record
from cellslam.scenarios.loading import load
from cellslam.scenarios.options import Request, resolve
from cellslam.sim.errors import InputError
from cellslam.sim.randomness import Stream, stream
from cellslam.slam.api import snapshots_of
from cellslam.slam.conformance_subject import tiny_drive

NAME = cellslam.benchmarks.env.LOCALIZATION


def made(**words: Any) -> Any:
    return gym.make(NAME, **words).unwrapped


@pytest.mark.parametrize("name", [NAME, f"cellslam.benchmarks.env:{NAME}"])
def test_passes_the_checker_without_warnings(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(name, drives=1, render_mode="rgb_array").unwrapped)


def test_same_seed_same_episode() -> None:
    env, seen = made(drives=4), []
    for _ in range(2):
        first, _ = env.reset(seed=3)
        states = [first, *(env.step(np.full(6, 1e-4))[0] for _ in range(5))]
        seen.append(np.concatenate([np.ravel(v) for s in states for v in s.values()]))
    np.testing.assert_array_equal(*seen)
    other, _ = env.reset()
    assert not np.array_equal(other["paths"], first["paths"])


def test_observation_holds_a_snapshot_exactly() -> None:
    for t, snapshot in enumerate(snapshots_of(tiny_drive())[:50]):
        back = snapshot_of(observation(snapshot, 0.1, np.zeros(6), np.zeros(6), 64), t, int(snapshot.row[0]))
        for name, value in vars(snapshot).items():
            np.testing.assert_array_equal(getattr(back, name), value, err_msg=name)


def test_strongest_paths_are_kept() -> None:
    snapshot = snapshots_of(tiny_drive())[0]
    few = observation(snapshot, 0.1, np.zeros(6), np.zeros(6), 5)
    assert few["mask"].sum() == 5
    np.testing.assert_array_equal(np.sort(few["paths"][:, 3]), np.sort(snapshot.snr_db)[-5:])
    assert (np.diff(few["link"]) >= 0).all()


def test_truth_is_in_info_alone_and_rewards_are_errors() -> None:
    env = made(drives=1)
    _, info = env.reset(seed=0)
    truth = info["truth_pose"]
    np.testing.assert_array_equal(info["start_pose"], truth)
    _, reward, ended, cut, info = env.step(np.array([3.0, 4.0, 0, 0, 0, 0]) / ACTION_UNIT)
    assert reward == pytest.approx(-5.0)
    assert info["position_error_m"] == pytest.approx(5.0)
    assert not ended
    assert not cut


@pytest.mark.parametrize("name", ["ekf-slam", "dead-reckoning"])
def test_estimator_in_the_environment_is_the_estimator_of_run(name: str) -> None:
    scenario = load("tiny")
    (request,) = resolve(scenario.estimator, (name,))
    warm_up(request)
    expected = estimate(record(scenario, 11, 0), request, stream(11, 0, Stream.ESTIMATOR))
    env = made()
    seen, _ = env.reset(options={"scenario": "tiny", "seed": 11})
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
        return lambda seen: seen["odometry"] * seen["dt_s"] / ACTION_UNIT


def test_agent_can_be_scored_as_an_estimator() -> None:
    recording = tiny_drive()
    (reference,) = resolve({}, ("dead-reckoning",))
    poses = [
        estimate(recording, request, np.random.default_rng(0)).poses
        for request in (Request("wheels", Wheels, None), reference)
    ]
    np.testing.assert_allclose(*poses, atol=1e-9)


def test_fast_enough_in_lund() -> None:
    env = made(scenario="lund-530", drives=1, overrides={"vehicle.distance_m": 60.0, "vehicle.duration_s": 90.0})
    env.reset(seed=0)
    action, begin = np.zeros(6), time.perf_counter()
    for _ in range(1000):
        env.step(action)
    assert 1000 / (time.perf_counter() - begin) > 500


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectorises(mode: Any) -> None:
    vector = gym.make_vec(NAME, num_envs=2, vectorization_mode=mode, drives=2)
    try:
        seen, _ = vector.reset(seed=[1, 2])
        assert seen["paths"].shape == (2, 128, 7)
        seen, rewards, *_ = vector.step(np.zeros((2, 6)))
        assert rewards.shape == (2,)
    finally:
        vector.close()


def test_picture_shows_city_and_belief() -> None:
    env = made(drives=1, render_mode="rgb_array")
    env.reset(seed=0)
    bare = env.render()
    env.step(np.zeros(6))
    env.belief_covariance = np.eye(6) * 25.0
    assert bare.shape == (480, 480, 3)
    assert bare.dtype == np.uint8
    assert (env.render() != bare).any()
    assert len(np.unique(bare.reshape(-1, 3), axis=0)) > 20


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
