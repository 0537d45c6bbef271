"""Drives recorded and replayed from the command line, on the preset `tiny`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import pytest

from cellslam.benchmarks import run as run_trials
from cellslam.benchmarks.scores.metrics import COST_KEYS, ROW_KEYS
from tests.command_line import Run, refused
from tests.sealing import resealed
from tests.short_drive import SET, SHORT

DETECTED = "estimator.fastslam.detection_probability"


def steady(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in COST_KEYS} for row in rows]


@pytest.mark.slow
def test_same_seed_same_rows_also_from_python_and_through_a_recording(cellslam: Run, tmp_path: Path) -> None:
    words = ("--json", "--no-figures", "--quiet")
    run = cellslam("run", "tiny", *SHORT, "--seed", "7", *words)
    assert run.err == ""
    frame = run_trials("tiny", ["fastslam", "ekf-slam", "dead-reckoning"], 1, 7, SET)
    assert tuple(frame.columns) == ROW_KEYS
    plain = [{k: None if v != v else v for k, v in row.items()} for row in frame.to_dict("records")]
    assert steady(run.rows) == steady(plain)
    assert cellslam("record", "tiny", *SHORT, "--seed", "7", "--out", "a.h5").status == 0
    replay = cellslam("replay", "a.h5", *words)
    assert replay.status == 0
    assert steady(replay.rows) == steady(run.rows)
    drawing = ("--estimator", "phd-slam", "--set", "estimator.phd-slam.particles=10")
    draws = (*drawing, "--estimator", "dead-reckoning", *words)
    same, other = (cellslam("replay", "a.h5", "--seed", seed, *draws).rows for seed in ("7", "8"))
    assert other[1]["position_rmse_m"] == same[1]["position_rmse_m"] == run.rows[2]["position_rmse_m"]
    assert other[0]["position_rmse_m"] != same[0]["position_rmse_m"]


def test_a_data_set_of_many_drives_goes_on_where_it_ended(cellslam: Run, tmp_path: Path) -> None:
    assert cellslam("record", "tiny", "--trials", "1", "--out", "drives").status == 0
    first = (tmp_path / "drives" / "tiny-0-0000.h5").stat().st_mtime_ns
    more = cellslam("record", "tiny", "--trials", "2", "--out", "drives")
    assert more.status == 0 and "tiny-0-0001.h5" in more.err and "0000" not in more.err
    assert (tmp_path / "drives" / "tiny-0-0000.h5").stat().st_mtime_ns == first
    other = cellslam("record", "tiny", "--trials", "1", "--out", "drives", "--set", "radio.load=0.1")
    assert other.status == 2 and "tiny-0-0000.h5: is of another scenario" in other.err
    words = ("--estimator", "dead-reckoning", "--json", "--no-figures")
    replayed = cellslam("replay", "drives/tiny-0-0001.h5", *words).rows
    assert steady(replayed) == steady(cellslam("run", "tiny", "--trials", "2", *words).rows[1:])


@pytest.mark.slow
def test_recorded_scenario_brings_its_options(cellslam: Run) -> None:
    option = ("--set", f"{DETECTED}=0.7")
    cellslam("record", "tiny", *SHORT, *option, "--out", "c.h5")
    words = ("--json", "--no-figures")
    brought = cellslam("replay", "c.h5", *words).rows
    assert steady(brought) == steady(cellslam("run", "tiny", *SHORT, *option, *words).rows)
    changed = cellslam("replay", "c.h5", "--set", f"{DETECTED}=0.5", *words).rows
    assert changed[0]["position_rmse_m"] != brought[0]["position_rmse_m"]


@pytest.fixture
def drive(cellslam: Run) -> Path:
    assert cellslam("record", "tiny", *SHORT, "--out", "drive.h5").status == 0
    return Path("drive.h5")


REPLAY = ("replay", "drive.h5", "--estimator", "dead-reckoning", "--json")


def test_replay_of_what_another_version_simulated_is_without_bound(drive: Path, cellslam: Run) -> None:
    with h5py.File(drive, "r+") as file:
        file["truth/persisting_std"][...] *= 1.1
    refused(cellslam(*REPLAY, "--no-figures"), "drive.h5: damaged, truncated, or changed", "--accept-changed")
    done = cellslam(*REPLAY, "--no-figures", "--accept-changed")
    assert done.status == 0 and "without the bound: truth.persisting_std is not what" in done.err
    (row,) = done.rows
    assert row["position_rmse_m"] > 0.0 and row["bound_position_rmse_m"] is None


def test_replay_without_truth_and_provenance(drive: Path, cellslam: Run) -> None:
    with resealed(drive) as file:
        del file["truth"]
        del file["provenance"]
        file["provenance"] = "{}"
        file["provenance"].attrs["unit"] = "JSON"
    (row,) = cellslam(*REPLAY).rows
    assert (row["scenario"], row["seed"], row["position_rmse_m"]) == ("drive", 0, None)
    assert Path("results/replay-drive/summary.json").exists()


def test_replay_refuses_what_a_recording_fixes(drive: Path, cellslam: Run) -> None:
    refused(cellslam(*REPLAY, "--quiet", "--set", "radio.load=0.1"), "radio.load")


@pytest.mark.slow
def test_responses_stand_beside_the_recording(tmp_path: Path, cellslam: Run) -> None:
    keys = ("radio.front_end=signal", "vehicle.duration_s=12", "vehicle.snapshot_interval_s=1",
            "vehicle.distance_m=4", "vehicle.stops=0")  # fmt: skip
    words = [word for key in keys for word in ("--set", key)]
    assert cellslam("record", "tiny", "--out", "a.h5", "--responses", *words).status == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a-responses.h5", "a.h5"]


def test_trials_are_counted_from_zero(cellslam: Run) -> None:
    refused(cellslam("record", "tiny", "--out", "a.h5", "--trial", -1), "trial = -1: must be 0 or more")


def test_responses_are_of_signals_and_refused_before_anything_is_simulated(tmp_path: Path, cellslam: Run) -> None:
    refused(cellslam("record", "tiny", "--out", "a.h5", "--responses"), "radio.front_end=signal")
    assert not list(tmp_path.iterdir())
