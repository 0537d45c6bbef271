"""`cellslam reproduce`: published and own figures side by side, kept, resumed, dry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.benchmarks.cli.main import main
from cellslam.benchmarks.cli.reproduce import comparison
from cellslam.benchmarks.sweeps.rows import results
from cellslam.scenarios.known_worlds import phd_slam_3

WORDS = ("reproduce", "phd-slam-3", "--executor", "serial", "--no-trajectories", "--seed", "5", "--trials")


def test_figures_are_printed_kept_and_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    world = phd_slam_3.WORLD
    monkeypatch.setattr(phd_slam_3, "WORLD", replace(world, entries=world.entries[:1]))
    out = ("--out", str(tmp_path / "found"))
    assert main([*WORDS, "1", *out]) == 0
    shown = capsys.readouterr()
    assert "1 row are in" in shown.err or "1 new" in shown.err
    line = next(text for text in shown.out.splitlines() if text.startswith(" 1 particle"))
    assert "3.45" in line and line.split()[-1] == "1"
    assert "What differs" in shown.out
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


def test_unknown_worlds_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "bp-slam-testbd"]) == 2
    assert "did you mean 'bp-slam-testbed'" in capsys.readouterr().err
