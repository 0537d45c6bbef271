"""A stable-baselines3 policy learns in the environment, and is scored as an estimator beside the others."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
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

TUTORIAL = Path(__file__).parents[3] / "docs" / "tutorials" / "train-an-agent.md"


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


def test_lines_of_the_tutorial_train_an_agent_better_than_odometry(tmp_path: Path) -> None:
    """With a third of the steps, on two drives that neither the tutorial nor the search for its options has seen."""
    agent, _, trained, ppo = re.findall(r"```python\n(.*?)```", TUTORIAL.read_text(), re.S)
    own = f"import numpy as np\n\n\n{agent[agent.index('class Agent') :]}"
    (tmp_path / "agent.py").write_text(f"{own}\n\n{trained}")
    (tmp_path / "ppo.py").write_text(ppo.replace("100_000", "32_000"))
    subprocess.run([sys.executable, "ppo.py"], cwd=tmp_path, check=True)
    run = "run tiny --set odometry.gyro_bias_deg_per_s=0.5 --seed 91 --trials 2 --no-figures --json"
    names = ("ppo:Learned", "dead-reckoning")
    asked = [word for name in names for word in ("--estimator", name)]
    line = [sys.executable, "-m", "cellslam", *run.split(), *asked]
    rows = json.loads(subprocess.run(line, cwd=tmp_path, check=True, capture_output=True).stdout)
    error = {name: [r["position_rmse_m"] for r in rows if r["estimator"] == name] for name in names}
    assert sum(error["ppo:Learned"]) < sum(error["dead-reckoning"])
