"""A stable-baselines3 policy learns in the environment, and is scored as an estimator beside the others."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest

import cellslam.benchmarks.env
from cellslam.benchmarks.env.adapters import AgentEstimator
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import Request
from cellslam.slam.conformance.subject import tiny_drive

stable_baselines3 = pytest.importorskip(
    "stable_baselines3", reason="stable-baselines3 is not installed: pip install stable-baselines3"
)


class Learned(AgentEstimator):
    """A trained model as an estimator."""

    name: ClassVar[str] = "ppo"
    model: ClassVar[Any] = None

    def policy(self) -> Any:
        return lambda seen: self.model.predict(seen, deterministic=True)[0]


@pytest.mark.filterwarnings("ignore")
def test_ppo_policy_is_scored_as_an_estimator() -> None:
    env = gym.make(cellslam.benchmarks.env.LOCALIZATION, scenario="tiny", drives=2)
    model = stable_baselines3.PPO("MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(128)
    Learned.model = model
    poses = []
    for _ in range(2):
        result = estimate(tiny_drive(), Request("ppo", Learned, None), np.random.default_rng(0))
        poses.append(result.poses)
    np.testing.assert_array_equal(*poses)
    scores = score(tiny_drive(), result, None)
    assert scores["position_rmse_m"] is not None
    assert np.isfinite(scores["position_rmse_m"])
    assert np.ptp(result.poses[:, 0]) > 0.0  # it acts
