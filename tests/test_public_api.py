"""`import cellslam`: what a notebook needs, loaded when it is asked for, told in a few words."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import cellslam
from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.trials.trials import Trial
from cellslam.slam.api import snapshots_of

ROOT = Path(__file__).parents[1]
WANTED = {"run", "sweep", "simulate", "replay", "load", "Recording", "results", "trace", "Estimate", "Estimator"}


STAYS = """
import cellslam
import numpy as np

class Stays:
    name = "stays"
    requires_truth = False

    def __init__(self, options):
        pass

    def start(self, setup, rng):
        self.pose = setup.start_pose.copy()

    def step(self, dt_s, odometry, snapshot):
        return cellslam.Estimate(self.pose, np.eye(6))
"""


@pytest.fixture(scope="module")
def recording() -> cellslam.Recording:
    return cellslam.simulate("tiny", seed=1)


def test_names_are_shown_and_are_there() -> None:
    assert set(dir(cellslam)) >= WANTED
    for name in cellslam.__all__:
        assert getattr(cellslam, name) is not None
    assert cellslam.__version__ == version("cellslam")
    with pytest.raises(AttributeError, match="no attribute 'sweeep'"):
        _ = cellslam.sweeep  # type: ignore[attr-defined]


def test_import_loads_nothing_heavy() -> None:
    script = "import cellslam, sys; dir(cellslam); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "cellslam" in loaded
    assert not set(loaded) & {"numpy", "pandas", "pydantic", "numba", "scipy", "h5py"}


def test_rooms_are_found_where_a_checkout_is_the_working_directory() -> None:
    script = "import cellslam.sim.frames, cellslam.cli.main"
    subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True)


def test_reprs_are_short_and_tell_something(recording: cellslam.Recording) -> None:
    limit = bound(recording)
    assert repr(recording).startswith("Recording(400 snapshots, 29.9 s, sites=A, B, 6 links, ")
    assert "truth with" in repr(recording)
    assert repr(cellslam.load("tiny")).startswith("Scenario('tiny': half a minute")
    assert "pose_covariance=array(400, 6, 6)" in repr(limit)
    trial = Trial(0, recording, limit, ())
    for thing in (recording, recording.truth, limit, trial, cellslam.load("lund-530"), snapshots_of(recording)[0]):
        assert 30 < len(repr(thing)) < 600
        assert "<" not in repr(thing) or " of " in repr(thing)


@pytest.mark.slow
def test_run_takes_a_class_of_ones_own_and_a_lone_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "standing_still.py").write_text(STAYS)
    monkeypatch.syspath_prepend(tmp_path)
    stays: Any = import_module("standing_still").Stays
    rows = cellslam.run("tiny", [stays, "dead-reckoning"], trials=2, seed=3)
    assert list(rows["status"]) == ["ok"] * 4
    assert rows.loc[0, "position_rmse_m"] > rows.loc[1, "position_rmse_m"]
    lone = cellslam.run("tiny", "dead-reckoning", trials=2, seed=3)
    assert lone["position_rmse_m"].tolist() == rows["position_rmse_m"].tolist()[1::2]


def test_replay_scores_as_run_does(recording: cellslam.Recording, tmp_path: Path) -> None:
    recording.save(tmp_path / "drive.h5")
    by_run = cellslam.run("tiny", "dead-reckoning", seed=1)["position_rmse_m"]
    for drive in (recording, tmp_path / "drive.h5"):
        assert cellslam.replay(drive, "dead-reckoning")["position_rmse_m"].tolist() == by_run.tolist()


@pytest.mark.slow
def test_sweep_goes_on_where_it_stopped(tmp_path: Path) -> None:
    axes = {"radio.load": [0.0, 0.5]}
    first = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    rows = first.rows
    assert rows["radio.load"].tolist() == [0.0, 0.5]
    again = cellslam.sweep("tiny", axes, tmp_path, "dead-reckoning", jobs=1)
    assert again.rows.equals(rows)  # with the times of the first
    table = first.table()
    assert table["radio.load"].tolist() == [0.0, 0.0, 0.5, 0.5]
    assert table["estimator"].tolist() == ["dead-reckoning", "bound"] * 2
    assert table["position_rmse_m"].tolist()[::2] == rows["position_rmse_m"].tolist()
    assert list(first.table(["nees_mean"], "max").columns) == ["radio.load", "estimator", "nees_mean"]
    assert "dead-reckoning" in repr(first) and "<table" in first._repr_html_()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: cellslam.run("tiny", "fastslm"), "fastslm.*fastslam"),
        (lambda: cellslam.run("tinny"), "tinny.*tiny"),
        (lambda: cellslam.run("tiny", trials=0), "trials = 0"),
        (lambda: cellslam.run("tiny", [3]), "estimator 3"),  # type: ignore[list-item]
        (lambda: cellslam.run("tiny", overrides={"radio.loud": 1}), "radio.loud"),
        (lambda: cellslam.replay("missing.h5"), "missing.h5"),
    ],
)
def test_wrong_requests_name_the_value(call: Any, says: str) -> None:
    with pytest.raises(cellslam.InputError, match=says):
        call()


def test_the_command_line_is_a_module_too() -> None:
    shown = subprocess.run([sys.executable, "-m", "cellslam", "--help"], capture_output=True, text=True, check=True)
    assert shown.stdout.startswith("usage: cellslam ")


@pytest.mark.slow
def test_a_trial_shows_itself_and_has_figures_and_arrays_by_name() -> None:
    trial = cellslam.trial("tiny", ["ekf-slam", "dead-reckoning"], seed=1)
    rows = cellslam.run("tiny", ["ekf-slam", "dead-reckoning"], seed=1)
    assert trial.rows.position_rmse_m.tolist() == rows.position_rmse_m.tolist()
    assert "tiny, seed 1, trial 0" in repr(trial) and "ekf-slam" in repr(trial)
    assert trial._repr_html_().startswith("<table") and "nees_mean" in trial._repr_html_()
    assert trial.recording is not None and trial.recording.truth is not None and trial.bound is not None
    assert trial.estimates["ekf-slam"].poses.shape == trial.recording.truth.poses.shape
    assert trial.plot("error").axes and trial.plot().axes
    with pytest.raises(cellslam.InputError, match="unknown figure 'mapp'; did you mean 'map'"):
        trial.plot("mapp")
    alone = cellslam.trial("tiny", "dead-reckoning", seed=1, number=1)
    assert alone.rows.trial.tolist() == [1]
    with pytest.raises(cellslam.InputError, match="none of the estimators"):
        alone.plot("clock_offsets")
