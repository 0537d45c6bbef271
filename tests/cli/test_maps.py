"""Maps on the command line: kept by one drive, used by the next, and by drives of a sequence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.trials.earlier_drives import Before
from cellslam.cli import main as cli
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.slam.model.vt_map import VtMap
from tests.command_line import Run, refused

KNOWN_CLOCKS = ("--set", "radio.clock_offset_std_m=0")
EKF = ("--estimator", "ekf-slam", "--no-figures", "--quiet")


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map that a drive left."""
    folder = tmp_path_factory.mktemp("map")
    given = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--seed", "72", "--out", str(folder / "out"))
    assert cli.main([*given, "--save-map", str(folder / "map.h5")]) == 0
    return folder / "map.h5"


@pytest.mark.slow
def test_run_and_replay_begin_with_what_a_drive_left(first: Path, cellslam: Run) -> None:
    known = VtMap.load(first)
    assert len(known) > 3 and known.provenance["recording"]["seed"] == 72
    both = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--estimator", "dead-reckoning", "--seed", "73", "--json")
    plain, informed = cellslam(*both).rows, cellslam(*both, "--map", first).rows
    assert informed[0]["position_rmse_m"] != plain[0]["position_rmse_m"]
    assert informed[0]["bound_position_rmse_m"] is None  # that of a drive without a map does not hold
    assert informed[1]["position_rmse_m"] == plain[1]["position_rmse_m"]
    assert cellslam("record", "tiny", *KNOWN_CLOCKS, "--seed", "73", "--out", "drive.h5").status == 0
    replayed = cellslam("replay", "drive.h5", *EKF, "--map", first, "--save-map", "second.h5", "--json").rows
    assert replayed[0]["position_rmse_m"] == informed[0]["position_rmse_m"]
    assert VtMap.load("second.h5").hits.max() > known.hits.max()


@pytest.mark.slow
def test_a_sequence_begins_with_its_earlier_drives(cellslam: Run) -> None:
    given = ("sweep", "tiny", *KNOWN_CLOCKS, "--sweep", "map.drives=1,2", "--estimator", "ekf-slam", "--quiet")
    assert cellslam(*given, "--seed", "72", "--executor", "serial", "--out", "out").status == 0
    found = results("out")
    assert found["map.drives"].tolist() == [1, 2] and (found["status"] == "ok").all()
    alone_m, second_m = found["bound_position_rmse_m"]
    assert second_m < alone_m and found["position_rmse_m"].nunique() == 2


@pytest.mark.slow
def test_cars_leave_one_map_together() -> None:
    scenario = load("tiny", {"radio.clock_offset_std_m": 0})
    (request,) = resolve(scenario.estimator, ["ekf-slam"])

    def before(cars: int, drives: int = 2) -> VtMap:
        config = scenario.map.model_copy(update={"drives": drives, "cars": cars})
        found = Before(config, scenario, 72, 0).known(request)
        assert found is not None
        return found

    one, two, later = before(1), before(2), before(2, 3)
    assert len(two.provenance["joined"]) == 2 and "joined" not in one.provenance
    assert later.hits.sum() > two.hits.sum()


@pytest.mark.slow
def test_maps_are_joined(first: Path, cellslam: Run) -> None:
    given = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--seed", "73")
    assert cellslam(*given, "--save-map", "second.h5").status == 0
    text = cellslam("map", "join", first, "second.h5", "--out", "both.h5").out
    maps = [VtMap.load(file) for file in (first, "second.h5", "both.h5")]
    assert f"{len(maps[1])} VTs" in text and f"both.h5: {len(maps[2])} VTs" in text
    assert max(map(len, maps[:2])) <= len(maps[2]) < len(maps[0]) + len(maps[1])
    assert [of["recording"]["seed"] for of in maps[2].provenance["joined"]] == [72, 73]
    replace(maps[0], position_m=maps[0].position_m + 40.0).save("elsewhere.h5")
    for files, why in (
        ((first, "elsewhere.h5"), "elsewhere.h5: the maps do not fit each other"),
        ((first,), "give two or more files"),
        ((first, "none.h5"), "no such file"),
    ):
        refused(cellslam("map", "join", *files, "--out", "both.h5"), why)


def test_requests_that_cannot_be_met_say_why(first: Path, cellslam: Run) -> None:
    Path("broken.h5").write_bytes(first.read_bytes()[:2000])
    alone = ("--estimator", "dead-reckoning")
    for words, text in (
        (("run", "tiny", "--map", "broken.h5", *EKF), "truncated"),
        (("run", "tiny", "--map", first, *alone), "use ekf-slam or fastslam"),
        (("run", "tiny", "--save-map", "broken.h5", *alone), "leaves one"),
        (("sweep", "tiny", "--map", "broken.h5", "--out", "out"), "truncated"),
    ):
        refused(cellslam(*words), text)
