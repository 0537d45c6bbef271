"""Maps on the command line: kept by one drive, begun with by the next, and by drives of a sequence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.trials import earlier_drives
from cellslam.benchmarks.trials.earlier_drives import APART, Before
from cellslam.cli import main as cli
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.slam.model import map_joining
from cellslam.slam.model.vt_map import VtMap

KNOWN_CLOCKS = ("--set", "radio.clock_offset_std_m=0")
EKF = ("--estimator", "ekf-slam", "--no-figures")


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map that a drive left."""
    folder = tmp_path_factory.mktemp("map")
    given = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--seed", "72", "--out", str(folder / "out"))
    assert cli.main(["--quiet", *given, "--save-map", str(folder / "map.h5")]) == 0
    return folder / "map.h5"


def rows(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, float]]:
    capsys.readouterr()
    assert cli.main(["--quiet", *arguments, "--json"]) == 0
    found: list[dict[str, float]] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.slow
def test_run_and_replay_begin_with_what_a_drive_left(
    first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = VtMap.load(first)
    assert len(known) > 3 and known.provenance["recording"]["seed"] == 72
    both = (*KNOWN_CLOCKS, *EKF, "--estimator", "dead-reckoning", "--seed", "73", "--out", str(tmp_path / "a"))
    plain = rows(capsys, "run", "tiny", *both)
    begun = rows(capsys, "run", "tiny", *both, "--map", str(first))
    assert begun[0]["position_rmse_m"] != plain[0]["position_rmse_m"]
    assert begun[0]["bound_position_rmse_m"] is None  # that of a drive without a map does not hold
    assert begun[1]["position_rmse_m"] == plain[1]["position_rmse_m"]
    drive, second = tmp_path / "drive.h5", tmp_path / "second.h5"
    assert cli.main(["--quiet", "record", "tiny", *KNOWN_CLOCKS, "--seed", "73", "--out", str(drive)]) == 0
    given = ("replay", str(drive), *EKF, "--out", str(tmp_path / "b"), "--map", str(first))
    assert rows(capsys, *given, "--save-map", str(second))[0]["position_rmse_m"] == begun[0]["position_rmse_m"]
    assert VtMap.load(second).hits.max() > known.hits.max()


@pytest.mark.slow
def test_a_sequence_begins_with_its_earlier_drives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--seed", "72", "--out", str(tmp_path / "a"))
    (alone,), (second,) = rows(capsys, *given), rows(capsys, *given, "--set", "map.drives=2")
    assert second["bound_position_rmse_m"] < alone["bound_position_rmse_m"]
    assert second["position_rmse_m"] != alone["position_rmse_m"]
    keys = {"radio.clock_offset_std_m": 0, "map.drives": 3}
    scenario = load("tiny", keys)
    (request,) = resolve(scenario.estimator, ["ekf-slam"])
    one, two = (Before(scenario.map.model_copy(update={"drives": n}), scenario, 72, 0).known(request) for n in (2, 3))
    assert one is not None and two is not None and two.hits.sum() > one.hits.sum()
    assert APART > 10_000


def test_a_world_of_one_car_is_called_as_before_there_were_more() -> None:
    assert "cars" not in load("tiny").resolved["map"]
    assert load("tiny", {"map.cars": 2}).resolved["map"]["cars"] == 2


@pytest.mark.slow
def test_cars_leave_one_map_together(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load("tiny", {"radio.clock_offset_std_m": 0})
    (request,) = resolve(scenario.estimator, ["ekf-slam"])

    def before(cars: int, drives: int = 2) -> VtMap | None:
        config = scenario.map.model_copy(update={"drives": drives, "cars": cars})
        return Before(config, scenario, 72, 0).known(request)

    one, two, later = before(1), before(2), before(2, 3)
    assert one is not None and two is not None and later is not None
    assert len(two.provenance["joined"]) == 2 and "joined" not in one.provenance
    assert later.hits.sum() > two.hits.sum()
    # A map that does not fit is left out.
    earlier_drives._left.cache_clear()
    monkeypatch.setattr(map_joining, "MOST_APART", 0.0)
    alone = before(2)
    assert alone is not None and alone.position_m.tolist() == one.position_m.tolist()


def test_maps_are_joined(first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    second, both = tmp_path / "second.h5", tmp_path / "both.h5"
    given = ("run", "tiny", *KNOWN_CLOCKS, *EKF, "--seed", "73", "--out", str(tmp_path / "out"))
    assert cli.main(["--quiet", *given, "--save-map", str(second)]) == 0
    capsys.readouterr()
    assert cli.main(["map", "join", str(first), str(second), "--out", str(both)]) == 0
    said, maps = capsys.readouterr().out, [VtMap.load(file) for file in (first, second, both)]
    assert f"{len(maps[1])} VTs" in said and f"{both}: {len(maps[2])} VTs" in said
    assert max(map(len, maps[:2])) <= len(maps[2]) < len(maps[0]) + len(maps[1])
    assert [of["recording"]["seed"] for of in maps[2].provenance["joined"]] == [72, 73]
    elsewhere = tmp_path / "elsewhere.h5"
    replace(maps[0], position_m=maps[0].position_m + 40.0).save(elsewhere)
    for files, why in (
        ((first, elsewhere), f"{elsewhere}: the maps do not fit each other"),
        ((first,), "give two or more files"),
        ((first, tmp_path / "none.h5"), "no such file"),
    ):
        assert cli.main(["map", "join", *map(str, files), "--out", str(both)]) == 2
        error = capsys.readouterr().err
        assert why in error and error.count("\n") == 1


def test_requests_that_cannot_be_met_say_why(first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "broken.h5"
    broken.write_bytes(first.read_bytes()[:2000])
    out = ("--out", str(tmp_path / "out"))
    for arguments, said in (
        (("run", "tiny", "--map", str(broken), *EKF, *out), "truncated"),
        (("run", "tiny", "--map", str(tmp_path / "none.h5"), *EKF, *out), "no such file"),
        (("run", "tiny", "--map", str(first), "--estimator", "dead-reckoning", *out), "use ekf-slam or fastslam"),
        (("run", "tiny", "--save-map", str(broken), "--estimator", "dead-reckoning", *out), "leaves one"),
        (("run", "tiny", "--save-map", str(broken), "--trials", "2", *EKF, *out), "leave out --trials"),
        (("sweep", "tiny", "--map", str(broken), *out), "truncated"),
    ):
        capsys.readouterr()
        assert cli.main(list(arguments)) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1


@pytest.mark.slow
def test_drives_of_a_sequence_are_points_of_a_sweep(tmp_path: Path) -> None:
    given = ("sweep", "tiny", *KNOWN_CLOCKS, "--sweep", "map.drives=1,2", "--estimator", "ekf-slam")
    assert cli.main(["--quiet", *given, "--seed", "72", "--executor", "serial", "--out", str(tmp_path)]) == 0
    found = results(tmp_path)
    assert found["map.drives"].tolist() == [1, 2] and found["position_rmse_m"].nunique() == 2
    assert (found["status"] == "ok").all()
