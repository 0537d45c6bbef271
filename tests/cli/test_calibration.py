"""A car's calibration on the command line: kept by one drive, drawn, exported, used by the next."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellslam.cli import main as cli
from cellslam.slam.model.calibration import Calibration
from tests.command_line import Run, refused

CAR = ("--set", "radio.array_seed=4", "--set", "radio.clock_offset_std_m=0")
EKF = ("--estimator", "ekf-slam")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("car") / "drive.h5"
    assert cli.main(["--quiet", "record", "tiny", *CAR, "--seed", "72", "--out", str(path)]) == 0
    return path


@pytest.mark.slow
def test_one_drive_leaves_what_the_next_begins_with(drive: Path, cellslam: Run) -> None:
    assert cellslam("replay", drive, *EKF, "--out", "a", "--save-calibration", "car.h5").status == 0
    assert Path("a/calibration-ekf-slam.png").stat().st_size > 10_000
    known = Calibration.load("car.h5")
    assert known.provenance["estimator"] == "ekf-slam" and known.provenance["recording"]["seed"] == 72
    assert cellslam("figures", "car.h5").status == 0 and Path("car.png").exists()
    assert cellslam("export", drive, *EKF, "--format", "calibration", "--out", "array.csv").status == 0
    rows = pd.read_csv("array.csv")
    mean, std = known.at(np.radians(rows[["azimuth_deg", "elevation_deg"]].to_numpy()))
    np.testing.assert_allclose(rows["distance_error_mean_m"], mean[:, 0], atol=1e-5)
    np.testing.assert_allclose(rows["elevation_error_std_deg"], np.degrees(std[:, 2]), rtol=1e-4)
    both = ("replay", drive, *EKF, "--estimator", "dead-reckoning", "--json", "--no-figures", "--quiet", "--out", "b")
    plain, informed = cellslam(*both).rows, cellslam(*both, "--calibration", "car.h5").rows
    assert informed[0]["position_rmse_m"] != plain[0]["position_rmse_m"]
    assert informed[1]["position_rmse_m"] == plain[1]["position_rmse_m"]


def test_requests_that_cannot_be_met_say_why(drive: Path, cellslam: Run) -> None:
    run, save, alone = ("run", "tiny", "--quiet"), ("--save-calibration", "car.h5"), ("--estimator", "dead-reckoning")
    for words, text in (
        ((*run, *alone, "--calibration", "car.h5"), "dead-reckoning cannot use it"),
        (("replay", drive, *EKF, "--calibration", drive), "not a calibration"),
        ((*run, *EKF, "--trials", "2", *save), "leave out --trials 2"),
        ((*run, *alone, *save), "no estimator leaves one"),
        (("export", drive, "--format", "calibration"), "say --estimator"),
    ):
        refused(cellslam(*words, "--out", "out"), text)


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


@pytest.mark.slow
def test_estimator_in_a_process_of_its_own_takes_and_gives_one(drive: Path, cellslam: Run) -> None:
    Path("owned.py").write_text(OWN)
    size, weights = np.array([0.2, 0.0, 0.0]), np.array([0.1, -0.3])
    covariance = np.array([[0.02, 0.01], [0.01, 0.03]])
    given = Calibration(size, np.radians(15.0), 1.1, 1.9, np.zeros(2, int), np.array([4, 9]), weights, covariance)
    given.save("car.h5")
    own = ("--quiet", "replay", drive, "--estimator", "owned:Own", "--no-figures", "--out", "out")
    assert cellslam(*own, "--calibration", "car.h5", "--save-calibration", "next.h5").status == 0
    found = Calibration.load("next.h5")
    np.testing.assert_array_equal(found.covariance, covariance)
    np.testing.assert_array_equal(found.cell, given.cell)
    assert found.provenance["estimator"] == "own"
    assert cellslam(*own, "--save-calibration", "none.h5").status == 1
