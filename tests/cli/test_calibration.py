"""A car's calibration on the command line: kept by one drive, drawn, exported, begun with by the next."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.cli import main as cli
from cellslam.slam.model.calibration import Calibration

CAR = ("--set", "radio.array_seed=4", "--set", "radio.clock_offset_std_m=0")
EKF = ("--estimator", "ekf-slam")


def replayed(drive: Path, out: Path, *more: str) -> int:
    return cli.main(["--quiet", "replay", str(drive), *EKF, "--out", str(out), *more])


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("car") / "drive.h5"
    assert cli.main(["--quiet", "record", "tiny", *CAR, "--seed", "72", "--out", str(path)]) == 0
    return path


@pytest.mark.slow
def test_one_drive_leaves_what_the_next_begins_with(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    car = tmp_path / "car.h5"
    assert replayed(drive, tmp_path / "a", "--save-calibration", str(car)) == 0
    assert (tmp_path / "a" / "calibration-ekf-slam.png").stat().st_size > 10_000
    known = Calibration.load(car)
    assert known.provenance["estimator"] == "ekf-slam" and known.provenance["recording"]["seed"] == 72
    assert known.provenance["options"]["calibration_m"] == 0.2
    assert cli.main(["--quiet", "figures", str(car)]) == 0
    assert {path.suffix for path in tmp_path.glob("car.*")} == {".h5", ".png", ".pdf"}
    table = tmp_path / "array.csv"
    assert cli.main(["export", str(drive), *EKF, "--format", "calibration", "--out", str(table)]) == 0
    rows = pd.read_csv(table)
    mean, std = known.at(np.radians(rows[["azimuth_deg", "elevation_deg"]].to_numpy()))
    np.testing.assert_allclose(rows["distance_error_mean_m"], mean[:, 0], atol=1e-5)
    np.testing.assert_allclose(rows["elevation_error_std_deg"], np.degrees(std[:, 2]), rtol=1e-4)
    assert rows["azimuth_error_truth_deg"].abs().max() > 0.1
    capsys.readouterr()
    both = ("--estimator", "dead-reckoning", "--json", "--no-figures")
    assert replayed(drive, tmp_path / "b", *both) == 0
    plain = json.loads(capsys.readouterr().out)
    assert replayed(drive, tmp_path / "b", *both, "--calibration", str(car)) == 0
    begun = json.loads(capsys.readouterr().out)
    assert begun[0]["position_rmse_m"] != plain[0]["position_rmse_m"]
    assert begun[1]["position_rmse_m"] == plain[1]["position_rmse_m"]


def test_requests_that_cannot_be_met_say_why(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    car = tmp_path / "car.h5"

    def said(*words: str) -> str:
        assert cli.main([*words, "--out", str(tmp_path / "out")]) == 2
        return capsys.readouterr().err

    assert "dead-reckoning cannot use it" in said(
        "run", "tiny", "--estimator", "dead-reckoning", "--calibration", str(car)
    )
    assert "estimator.ekf-slam: " in said("run", "tiny", *EKF, "--calibration", str(car))
    assert "not a calibration" in said("replay", str(drive), *EKF, "--calibration", str(drive))
    save = ("--save-calibration", str(car))
    assert "of ekf-slam or fastslam?" in said("run", "tiny", *EKF, "--estimator", "fastslam", *save)
    assert "leave out --trials 2" in said("run", "tiny", *EKF, "--trials", "2", *save)
    assert "no estimator leaves one" in said("run", "tiny", "--estimator", "dead-reckoning", *save)
    assert "there is no folder" in said("run", "tiny", *EKF, "--save-calibration", str(tmp_path / "no" / "car.h5"))
    assert "say --estimator" in said("export", str(drive), "--format", "calibration")


OWN = """
import numpy as np
from pydantic import BaseModel

import cellslam


class Own:
    name = "own"

    class Options(BaseModel):
        calibration_file: str | None = None

    def __init__(self, options):
        self.file = options.calibration_file

    def start(self, setup, rng):
        self.pose = setup.start_pose.copy()

    def step(self, dt_s, odometry, snapshot):
        return cellslam.Estimate(self.pose, np.eye(6))

    def calibration(self):
        return cellslam.Calibration.load(self.file) if self.file else None
"""


def test_estimator_in_a_process_of_its_own_takes_and_gives_one(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("owned.py").write_text(OWN)
    size, weights = np.array([0.2, 0.0, 0.0]), np.array([0.1, -0.3])
    covariance = np.array([[0.02, 0.01], [0.01, 0.03]])
    given = Calibration(size, np.radians(15.0), 1.1, 1.9, np.zeros(2, int), np.array([4, 9]), weights, covariance)
    given.save("car.h5")
    own = ("replay", str(drive), "--estimator", "owned:Own", "--no-figures", "--out", "out")
    assert cli.main(["--quiet", *own, "--calibration", "car.h5", "--save-calibration", "next.h5"]) == 0
    found = Calibration.load("next.h5")
    np.testing.assert_array_equal(found.covariance, covariance)
    np.testing.assert_array_equal(found.cell, given.cell)
    assert found.provenance["estimator"] == "owned:Own"
    assert cli.main(["--quiet", *own, "--save-calibration", "none.h5"]) == 1
