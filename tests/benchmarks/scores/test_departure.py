"""An estimate that departs from the odometry by more than it may is told, with and without truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.scores.departure import departure, worse_than_odometry
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.cli import main as cli
from cellslam.sim.recording import Recording

Toy = Callable[..., Recording]
LOST = """
from cellslam.slam.dead_reckoning import DeadReckoning

class Lost(DeadReckoning):
    '''Runs away at 5 m/s, and does not know.'''
    name = "lost"

    def step(self, dt_s, odometry, snapshot):
        return super().step(dt_s, odometry + [5.0, 5.0, 0, 0, 0, 0], snapshot)
"""


def result_of(poses: np.ndarray, std: float = 1e-3, name: str = "one") -> TrialResult:
    return TrialResult(name, poses, np.tile(std**2 * np.eye(6), (len(poses), 1, 1)))


def flat(drive: Recording) -> Recording:
    """Return a drive whose odometry errs in the plane alone, with white noise alone."""
    odometry = drive.odometry.copy()
    odometry[:, [2, 4, 5]] = 0.0
    return replace(drive, odometry=odometry, odometry_model=replace(drive.odometry_model, scale=np.zeros(6)))


def test_the_truth_departs_as_the_data_sheet_says(toy_recording: Toy) -> None:
    drives = [flat(toy_recording(600, seed)) for seed in range(20)]
    found = [departure(d, result_of(d.truth.poses)) for d in drives if d.truth]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.06)


def test_corrections_may_be_as_large_as_the_estimate_was_uncertain(toy_recording: Toy) -> None:
    drive = flat(toy_recording(600))
    assert drive.truth is not None
    jump = drive.truth.poses + 4.0 * (np.arange(600) > 250)[:, None] * np.eye(6)[0]
    assert departure(drive, result_of(jump)) > 3.0
    assert departure(drive, result_of(jump, 4.0)) < 1.0


def test_what_speaks_against_an_estimate_is_said(toy_recording: Toy) -> None:
    drive = flat(toy_recording(600))
    assert drive.truth is not None
    alone = result_of(drive.truth.poses + 0.5 * np.eye(6)[0])
    assert worse_than_odometry(drive, result_of(drive.truth.poses), alone) == []
    steps = np.cumsum(np.full(600, 0.05))[:, None] * np.eye(6)[1]
    worse, away = worse_than_odometry(drive, result_of(drive.truth.poses + steps), alone)
    assert worse.startswith("one: ") and worse.endswith("is worse than odometry alone, 0.50 m")
    assert away.startswith("one departs from the odometry by ")
    unscored = replace(drive, truth=None)
    assert worse_than_odometry(unscored, result_of(drive.truth.poses + steps), alone) == [away]


def test_what_is_learnt_is_not_recommended(toy_recording: Toy) -> None:
    drive = flat(toy_recording(600))
    assert drive.truth is not None
    steps = np.cumsum(np.full(600, 0.05))[:, None] * np.eye(6)[1]
    one, alone = result_of(drive.truth.poses + steps), result_of(drive.truth.poses + 0.5 * np.eye(6)[0])
    assert worse_than_odometry(drive, one, alone)[-1].endswith("the data sheet is too tight (--fit learns it)")
    assert worse_than_odometry(drive, one, alone, fitted=True)[-1].endswith("the data sheet is too tight")


def test_an_estimate_that_nothing_changed_says_why(toy_recording: Toy) -> None:
    drive = flat(toy_recording(600))
    assert drive.truth is not None
    poses = drive.truth.poses
    one, alone = result_of(poses + 5e-4 * np.eye(6)[0]), result_of(poses)
    exact = replace(drive, odometry_model=type(drive.odometry_model)(*np.zeros((4, 6))))
    clutter = replace(one, association=np.r_[0, np.full(len(drive.measurements) - 1, -1)])
    for recording, result, why in (
        (drive, one, "they weigh nothing beside the odometry"),
        (exact, one, "the odometry's data sheet says that it never errs"),
        (drive, clutter, f"it took {len(drive.measurements) - 1} of {len(drive.measurements)} for clutter"),
    ):
        (printed,) = worse_than_odometry(recording, result, alone)
        assert f"dead reckoning to the millimetre: the measurements changed nothing, since {why}" in printed
    assert "millimetre" not in "".join(worse_than_odometry(drive, result_of(poses + 2e-3 * np.eye(6)[0]), alone))


@pytest.mark.slow
def test_replay_and_inspect_say_it(
    toy_recording: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lost.py").write_text(LOST)
    monkeypatch.chdir(tmp_path)
    toy_recording(100).save(tmp_path / "a.h5")
    both = ["--estimator", "lost:Lost", "--estimator", "ekf-slam"]
    assert cli.main(["replay", "a.h5", *both, "--no-figures"]) == 0
    printed = capsys.readouterr().err
    assert "lost departs from the odometry by" in printed and "ekf-slam departs" not in printed
    assert cli.main(["inspect", "a.h5", *both, "--no-figure", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["estimators"]
    assert found["ekf-slam"] == [] and len(found["lost"]) == 2
