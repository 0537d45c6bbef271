"""Verdicts on the rows of a sweep: what is compared, over which trials, and the power of a suite."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from cellslam.benchmarks.tables.rankings import ALL, map_builders, significant_pairs, verdict_table, verdicts

NAMES = ("dead-reckoning", "ekf-slam", "fastslam", "mine:Mine", "oracle-map")
ORACLES = {"oracle-map"}
FACTOR = {"dead-reckoning": 8.0, "ekf-slam": 1.2, "fastslam": 1.0, "mine:Mine": 2.0, "oracle-map": 0.1}


def panel(scale: float, trials: int = 8) -> pd.DataFrame:
    """Rows of every estimator, whose errors differ by a factor; trial 0 of mine failed, trial 1 is not in yet."""
    hard = scale * np.random.default_rng(3).gamma(4.0, size=trials)
    rows = [
        {"estimator": name, "seed": 1, "trial": trial, "status": "ok", "position_rmse_m": FACTOR[name] * hard[trial],
         "map_gospa_m": None if name in ("dead-reckoning", "oracle-map") else 30.0}
        for name in NAMES for trial in range(trials) if (name, trial) != ("mine:Mine", 1)
    ]  # fmt: skip
    frame = pd.DataFrame(rows)
    failed = (frame["estimator"] == "mine:Mine") & (frame["trial"] == 0)
    frame.loc[failed, ["status", "position_rmse_m"]] = ["failed", None]
    return frame


def test_all_scenarios_are_one_score_a_trial_and_oracles_are_not_ranked() -> None:
    panels = {"easy": panel(1.0), "hard": panel(9.0)}
    found = verdicts(panels, ORACLES)
    assert list(found) == ["easy", "hard", ALL]
    for one in found.values():
        assert one.names == ("fastslam", "ekf-slam", "mine:Mine", "dead-reckoning") and one.trials == 7
        assert one.mean_rank.tolist() == pytest.approx([1.0, 2.0, 3 + 1 / 7, 4 - 1 / 7])
    # The geometric mean of x and 9 x is 3 x.
    np.testing.assert_allclose(found[ALL].difference[:2, :2], 3.0 * found["easy"].difference[:2, :2])
    assert list(verdicts({"": panel(1.0)}, ORACLES)) == [""]
    assert list(verdicts({f"{i}": panel(1.0) for i in range(13)}, ORACLES)) == [ALL]


def test_power_is_of_built_in_map_builders_whatever_else_is_there() -> None:
    panels = {"easy": panel(1.0)}
    few = map_builders(panels)
    assert set(few["easy"]["estimator"]) == {"ekf-slam", "fastslam"}
    # Six pairs of seven trials do not differ (6 x 2 / 128 is above 5 %), one pair is (2 / 2^8).
    assert significant_pairs(verdicts(panels, ORACLES)["easy"]) == "0 of 6 pairs (0 %)"
    (alone,) = verdicts(few).values()
    assert alone.trials == 8 and significant_pairs(alone) == "1 of 1 pairs (100 %)"
    lines = verdict_table(alone).splitlines()
    assert lines[0] == "| estimator | mean rank | fastslam | ekf-slam |"
    assert lines[2].startswith("| fastslam | 1.00 |  | **-") and lines[3].startswith("| ekf-slam | 2.00 | **")
