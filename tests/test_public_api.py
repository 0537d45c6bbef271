"""`import cellslam`: what a notebook needs, loaded when it is asked for, told in a few words."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import cellslam
from tests.command_line import PLUGIN


def test_names_are_there() -> None:
    for name in cellslam.__all__:
        assert getattr(cellslam, name) is not None
    assert cellslam.__version__ == version("cellslam")
    with pytest.raises(AttributeError, match="no attribute 'sweeep'"):
        _ = cellslam.sweeep  # type: ignore[attr-defined]


@pytest.mark.slow
def test_run_takes_a_class_of_ones_own_and_a_lone_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_estimators.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    own: Any = import_module("own_estimators").Mine
    rows = cellslam.run("tiny", [own, "dead-reckoning"], trials=2, seed=3)
    assert list(rows["status"]) == ["ok"] * 4
    lone = cellslam.run("tiny", "dead-reckoning", trials=2, seed=3)
    assert lone["position_rmse_m"].tolist() == rows["position_rmse_m"].tolist()[1::2]


@pytest.mark.slow
def test_sweep_goes_on_where_it_stopped(tmp_path: Path) -> None:
    axes = {"radio.load": [0.0, 0.5]}
    first = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    rows = first.rows
    assert rows["radio.load"].tolist() == [0.0, 0.5]
    again = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    assert again.rows.equals(rows)  # with the times of the first
    table = first.table()
    assert table["estimator"].tolist() == ["dead-reckoning", "bound"] * 2
    assert table["position_rmse_m"].tolist()[::2] == rows["position_rmse_m"].tolist()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: cellslam.run("tiny", "fastslm"), "fastslm.*fastslam"),
        (lambda: cellslam.run("tiny", trials=0), "trials = 0"),
        (lambda: cellslam.run("tiny", [3]), "estimator 3"),  # type: ignore[list-item]
        (lambda: cellslam.replay("missing.h5"), "missing.h5"),
    ],
)
def test_wrong_requests_name_the_value(call: Any, says: str) -> None:
    with pytest.raises(cellslam.InputError, match=says):
        call()


@pytest.mark.slow
def test_a_trial_shows_itself_and_has_figures_and_arrays_by_name() -> None:
    trial = cellslam.trial("tiny", ["ekf-slam", "dead-reckoning"], seed=1)
    rows = cellslam.run("tiny", ["ekf-slam", "dead-reckoning"], seed=1)
    assert trial.rows.position_rmse_m.tolist() == rows.position_rmse_m.tolist()
    assert trial.recording is not None and trial.recording.truth is not None and trial.bound is not None
    assert trial.estimates["ekf-slam"].poses.shape == trial.recording.truth.poses.shape
    assert trial.plot("error").axes and trial.plot().axes
    with pytest.raises(cellslam.InputError, match="unknown figure 'mapp'; did you mean 'map'"):
        trial.plot("mapp")
