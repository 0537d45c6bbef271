"""`import cellslam`: what a notebook needs, loaded when it is asked for, told in a few words."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from traceback import format_exception
from typing import Any

import pytest

import cellslam
from tests.command_line import PLUGIN


def test_names_are_there() -> None:
    for name in cellslam.__all__:
        assert getattr(cellslam, name) is not None
    assert cellslam.__version__ == version("cellslam")
    assert dir(cellslam) == sorted(cellslam.__all__)
    with pytest.raises(AttributeError, match="no attribute 'sweeep'"):
        _ = cellslam.sweeep  # type: ignore[attr-defined]


@pytest.mark.slow
def test_run_takes_a_class_of_ones_own_and_a_lone_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_estimators.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    own: Any = import_module("own_estimators").Mine
    rows = cellslam.run("tiny", [own, "dead-reckoning"], trials=2, seed=3)
    assert list(rows["status"]) == ["ok"] * 4 and rows["estimator"].tolist()[:2] == ["mine", "dead-reckoning"]
    lone = cellslam.run("tiny", "dead-reckoning", trials=2, seed=3)
    assert lone["position_rmse_m"].tolist() == rows["position_rmse_m"].tolist()[1::2]


@pytest.mark.slow
def test_what_an_estimator_raises_is_raised_with_the_line_of_its_author(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wrong_estimators.py").write_text(PLUGIN.replace("return Estimate(", "return 1 / 0, Estimate("))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(Exception, match="ZeroDivisionError") as raised:
        cellslam.run("tiny", "wrong_estimators:Mine")
    assert "wrong_estimators.py" in "".join(format_exception(raised.value))
    assert "return 1 / 0" in "".join(format_exception(raised.value))
    rows = cellslam.run("tiny", ["wrong_estimators:Mine", "dead-reckoning"], on_error="row")
    assert rows["status"].tolist() == ["failed", "ok"] and "ZeroDivisionError" in rows["error"][0]


def test_tables_of_pandas() -> None:
    trial = cellslam.trial("tiny", "dead-reckoning", seed=1)
    drive, truth = trial.recording, trial.recording.truth
    assert truth is not None
    assert drive.measurements.to_dataframe()["distance_m"].tolist() == drive.measurements.distance_m.tolist()
    snapshots = drive.to_dataframe()
    assert snapshots[["x_m", "yaw_rad"]].to_numpy().tolist() == truth.poses[:, [0, 3]].tolist()
    assert snapshots["u_x"].tolist() == drive.odometry[:, 0].tolist()
    assert truth.vts.to_dataframe()["y_m"].tolist() == truth.vts.position_m[:, 1].tolist()
    answered = trial.estimates["dead-reckoning"].to_dataframe()
    assert answered["x_m"].tolist() == trial.estimates["dead-reckoning"].poses[:, 0].tolist()
    assert len(cellslam.plot(drive).axes) == 2 * len(drive.links)


@pytest.mark.slow
def test_sweep_goes_on_where_it_stopped(tmp_path: Path) -> None:
    axes = {"radio.load": [0.0, 0.5]}
    first = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    rows = first.rows
    assert rows["radio.load"].tolist() == [0.0, 0.5]
    again = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    assert again.rows.equals(rows)  # with the times of the first
    assert "dead-reckoning" in repr(first) and "<table" in first._repr_html_()
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
        (lambda: cellslam.run("tiny", on_error="rows"), "unknown on_error 'rows'; did you mean 'row'"),  # type: ignore[arg-type]
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
    assert trial.recording.truth is not None and trial.bound is not None
    assert trial.estimates["ekf-slam"].poses.shape == trial.recording.truth.poses.shape
    assert trial.plot("error").axes and trial.plot().axes
    assert "tiny, seed 1, trial 0" in repr(trial) and "<table" in trial._repr_html_()
    with pytest.raises(cellslam.InputError, match="unknown figure 'mapp'; did you mean 'map'"):
        trial.plot("mapp")
