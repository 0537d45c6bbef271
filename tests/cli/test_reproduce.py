"""`cellslam reproduce`: published and own figures side by side, kept, resumed, dry; the paper's ladder and figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.benchmarks.sweeps.rows import results
from cellslam.cli.commands.reproduce import comparison, ladder
from cellslam.cli.main import main
from cellslam.scenarios.known_worlds import paper, phd_slam_3

WORDS = ("reproduce", "phd-slam-3", "--executor", "serial", "--no-trajectories", "--seed", "5", "--trials")


@pytest.mark.slow
def test_figures_are_printed_kept_and_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    world = phd_slam_3.WORLD
    monkeypatch.setattr(phd_slam_3, "WORLD", replace(world, entries=world.entries[:1]))
    out = ("--out", str(tmp_path / "found"))
    assert main([*WORDS, "1", *out]) == 0
    shown = capsys.readouterr()
    line = next(text for text in shown.out.splitlines() if text.startswith(" 1 particle"))
    assert "3.45" in line and line.split()[-1] == "1"
    (row,) = results(tmp_path / "found").to_dict("records")
    assert row["estimator"] == "phd-slam" and row["scenario"] == "phd-slam-3"
    assert row["position_rmse_m"] < 10.0 and row["bound_position_rmse_m"] is None
    assert main([*WORDS, "1", *out]) == 0
    assert "1 of them finished already" in capsys.readouterr().err


def test_a_table_has_the_interval_of_its_statistic() -> None:
    world = replace(phd_slam_3.WORLD, entries=phd_slam_3.WORLD.entries[:1])
    errors = [3.0, 4.0, 3.0, 4.0, 5.0, 3.5]
    rows = pd.DataFrame({figure.key: errors for figure in world.figures})
    columns = [list(column.cells) for column in comparison(world, [rows]).columns]
    assert columns[3][0] == f"{np.sqrt(np.mean(np.square(errors))):.2f}"
    assert columns[3][2] == f"{np.mean(errors):.2f}"
    low, high = (float(text) for text in columns[4][0].split(" to "))
    assert low < 3.8 < high
    assert columns[5][0] == "6"


@pytest.mark.slow
def test_paper_prints_the_ladder_and_draws_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paper, "PRESET", "tiny")
    words = ["reproduce", "paper", "--executor", "serial", "--trials", "2", "--seed", "5", "--out", str(tmp_path)]
    assert main(words) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    published = {line.split("  ")[0].strip(): line for line in lines if "largest error, m" in line and ".00" in line}
    assert "6.00" in published["FastSLAM"] and "20.00" in published["odometry alone"]
    rungs = [line for line in lines if line.strip().startswith("+")]
    assert len(rungs) == len(paper.WORLD.ladder) - 1 and all(line.split()[-1] == "2" for line in rungs)
    rows = results(tmp_path)
    assert len(rows) == 2 * (len(paper.WORLD.ladder) + 1)  # the filter of the first table is a rung, too
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"associations.png", "error.png", "map.png"}


def test_a_rung_is_worth_the_geometric_mean_of_its_ratios() -> None:
    world = replace(paper.WORLD, ladder=paper.WORLD.ladder[:2])
    errors = np.array([3.0, 4.0, 3.0, 4.0, 5.0, 3.5])
    before = pd.DataFrame({figure.key: errors for figure in world.figures} | {"trial": np.arange(6)})
    # In another order, and without the first run: pairs are by trial.
    after = before.assign(position_rmse_m=0.5 * errors * np.exp([9.0, 0.1, -0.1, 0.2, -0.2, 0.0])).iloc[:0:-1]
    columns = [list(column.cells) for column in ladder(world, [before, after]).columns]
    assert columns[-3] == ["-", "0.50"] and columns[-1] == ["6", "5"]
    low, high = (float(text) for text in columns[-2][1].split(" to "))
    assert 0.35 < low < 0.5 < high < 0.75
