"""A stable-baselines3 policy learns in the environment, and is scored as an estimator beside the others."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

stable_baselines3 = pytest.importorskip(
    "stable_baselines3", reason="stable-baselines3 is not installed: pip install stable-baselines3"
)

TUTORIAL = Path(__file__).parents[3] / "docs" / "tutorials" / "train-an-agent.md"


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
