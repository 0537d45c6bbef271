"""The command line end to end, on the preset `tiny`."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cellslam.benchmarks import run as run_trials
from cellslam.benchmarks.cli.main import build_parser, main
from cellslam.benchmarks.scores.trial_result import COST_KEYS, ROW_KEYS
from cellslam.scenarios import load
from cellslam.sim.recording import Recording

COMMAND = Path(sys.executable).parent / "cellslam"
FEW = ("--set", "estimator.fastslam.particles=20")

PLUGIN = """
import os, signal, time
import numpy as np
from cellslam.sim.frames import integrate_pose
from cellslam.slam.api import Estimate

class Mine:
    name = "mine"
    requires_truth = False
    def __init__(self, options): pass
    def start(self, setup, rng): self.pose = setup.start_pose
    def step(self, dt_s, odometry, snapshot):
        self.pose = integrate_pose(self.pose, odometry, dt_s)
        return Estimate(self.pose, np.eye(6))

class Fails(Mine):
    def step(self, dt_s, odometry, snapshot):
        if snapshot.index == 5:
            raise ArithmeticError("lost it")
        return super().step(dt_s, odometry, snapshot)

class Oracle(Mine):
    requires_truth = True

class Interrupted(Mine):
    started = 0
    def start(self, setup, rng):
        super().start(setup, rng)
        Interrupted.started += 1
        if Interrupted.started == 2:
            os.kill(os.getppid(), signal.SIGINT)  # as Ctrl-C does
            time.sleep(60)
"""


@dataclass
class Done:
    status: int
    out: str
    err: str

    @property
    def rows(self) -> list[dict[str, Any]]:
        return json.loads(self.out)


@pytest.fixture
def cellslam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Runs a command line in an empty directory, in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def run(*words: str) -> Done:
        capfd.readouterr()
        try:
            status = main(words)
        except SystemExit as error:
            status = int(error.code or 0)
        captured = capfd.readouterr()
        return Done(status, captured.out, captured.err)

    return run


@pytest.fixture
def plugin(cellslam: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delitem(sys.modules, "cli_plugin", raising=False)
    (tmp_path / "cli_plugin.py").write_text(PLUGIN)
    return tmp_path


def steady(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in COST_KEYS} for row in rows]


def left_over(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"cli_plugin.py", "__pycache__"}


def test_run_prints_a_table_and_writes_the_results(cellslam: Any, tmp_path: Path) -> None:
    done = cellslam("run", "tiny", *FEW)
    assert done.status == 0
    for word in ("fastslam", "dead-reckoning", "bound", "RMSE", "tiny, seed 0"):
        assert word in done.out
    assert "results/tiny-0" in done.err
    next_ones = [line.split("  ")[1] for line in done.err.split("worth trying next:\n")[1].splitlines()]
    assert [line.split()[1] for line in next_ones] == ["report", "run", "run"]
    for line in next_ones:
        words = shlex.split(line)[1:]
        assert build_parser(words).parse_args(words).command
    folder = tmp_path / "results" / "tiny-0"
    summary = json.loads((folder / "summary.json").read_text())
    assert [row["estimator"] for row in summary["rows"]] == ["fastslam", "dead-reckoning"]
    assert summary["command"] == f"cellslam run tiny {' '.join(FEW)}"
    assert summary["versions"]["cellslam"]
    snapshots = summary["rows"][0]["snapshots"]
    for name in ("fastslam", "dead-reckoning", "truth"):
        assert np.loadtxt(folder / f"trajectory-{name}.tum").shape == (snapshots, 8)
    scenario = load(folder / "scenario.toml")
    assert scenario.name == "tiny"
    assert scenario.estimator["fastslam"]["particles"] == 20
    assert scenario.world == load("tiny").world
    for figure in ("map", "error", "associations", "clock_offsets"):
        assert (folder / f"{figure}.png").read_bytes().startswith(b"\x89PNG")


def test_json_is_one_array_and_nothing_else(cellslam: Any, tmp_path: Path) -> None:
    done = cellslam("run", "tiny", *FEW, "--json", "--trials", "2", "--seed", "3", "--no-figures", "--out", "here")
    rows = done.rows
    assert done.status == 0
    assert [(row["trial"], row["estimator"]) for row in rows] == [
        *((0, "fastslam"), (0, "dead-reckoning"), (1, "fastslam"), (1, "dead-reckoning")),
    ]
    for row in rows:
        assert tuple(row) == ROW_KEYS
        assert (row["scenario"], row["seed"], row["status"], row["error"]) == ("tiny", 3, "ok", None)
        assert row["realtime_factor"] == pytest.approx(row["duration_s"] / row["estimate_seconds"])
    assert "NaN" not in done.out and "Infinity" not in done.out
    assert rows[1]["clock_offset_rmse_m"] is None
    assert rows[0]["position_rmse_m"] != rows[2]["position_rmse_m"]
    assert json.loads((tmp_path / "here" / "summary.json").read_text())["rows"] == rows
    assert (tmp_path / "here" / "trajectory-fastslam-1.tum").exists()
    assert not list((tmp_path / "here").glob("*.png"))


def test_same_seed_same_rows_also_from_python_and_through_a_recording(cellslam: Any, tmp_path: Path) -> None:
    words = ("--json", "--no-figures", "--quiet")
    run = cellslam("run", "tiny", *FEW, "--seed", "7", *words)
    assert run.err == ""
    frame = rows_from_python(seed=7)
    assert steady(run.rows) == frame
    assert cellslam("record", "tiny", "--seed", "7", "--out", "a.h5").status == 0
    replay = cellslam("replay", "a.h5", *FEW, *words)
    assert replay.status == 0
    assert steady(replay.rows) == steady(run.rows)
    draws = ("--estimator", "phd-slam", "--estimator", "dead-reckoning", "--set", "estimator.phd-slam.particles=10", *words)
    same, other = (cellslam("replay", "a.h5", "--seed", seed, *draws).rows for seed in ("7", "8"))
    assert other[1]["position_rmse_m"] == same[1]["position_rmse_m"] == run.rows[1]["position_rmse_m"]
    assert other[0]["position_rmse_m"] != same[0]["position_rmse_m"]
    another = cellslam("run", "tiny", "--estimator", "dead-reckoning", "--seed", "8", *words).rows
    assert another[0]["position_rmse_m"] != run.rows[1]["position_rmse_m"]


def rows_from_python(seed: int) -> list[dict[str, Any]]:
    frame = run_trials("tiny", ["fastslam", "dead-reckoning"], 1, seed, {"estimator.fastslam.particles": 20})
    assert tuple(frame.columns) == ROW_KEYS
    plain = [{k: None if v != v else v for k, v in row.items()} for row in frame.to_dict("records")]
    return steady(plain)


def test_second_trial_can_be_recorded(cellslam: Any) -> None:
    both = cellslam("run", "tiny", "--estimator", "dead-reckoning", "--trials", "2", "--json", "--no-figures").rows
    cellslam("record", "tiny", "--trial", "1", "--out", "b.h5")
    replay = cellslam("replay", "b.h5", "--estimator", "dead-reckoning", "--json", "--no-figures")
    assert steady(replay.rows) == steady(both[1:])


def test_a_data_set_of_many_drives_goes_on_where_it_ended(cellslam: Any, tmp_path: Path) -> None:
    assert cellslam("record", "tiny", "--trials", "1", "--out", "drives").status == 0
    first = (tmp_path / "drives" / "tiny-0-0000.h5").stat().st_mtime_ns
    more = cellslam("record", "tiny", "--trials", "2", "--out", "drives")
    assert more.status == 0 and "tiny-0-0001.h5" in more.err and "0000" not in more.err
    assert (tmp_path / "drives" / "tiny-0-0000.h5").stat().st_mtime_ns == first
    other = cellslam("record", "tiny", "--trials", "1", "--out", "drives", "--set", "radio.load=0.1")
    assert other.status == 2 and "tiny-0-0000.h5: is of another scenario" in other.err
    cellslam("record", "tiny", "--trial", "1", "--out", "one.h5")
    one, many = (Recording.load(tmp_path / name) for name in ("one.h5", "drives/tiny-0-0001.h5"))
    np.testing.assert_array_equal(one.measurements.distance_m, many.measurements.distance_m)


def test_recorded_scenario_brings_its_options(cellslam: Any) -> None:
    cellslam("record", "tiny", *FEW, "--out", "c.h5")
    words = ("--json", "--no-figures")
    brought = cellslam("replay", "c.h5", *words).rows
    assert steady(brought) == steady(cellslam("run", "tiny", *FEW, *words).rows)
    changed = cellslam("replay", "c.h5", "--set", "estimator.fastslam.detection_probability=0.5", *words).rows
    assert changed[0]["position_rmse_m"] != brought[0]["position_rmse_m"]


def test_replay_of_what_another_version_simulated_is_without_bound(cellslam: Any, tmp_path: Path) -> None:
    cellslam("record", "tiny", "--out", "old.h5")
    with h5py.File(tmp_path / "old.h5", "r+") as file:
        file["truth/persisting_std"][...] *= 1.1
    done = cellslam("replay", "old.h5", "--estimator", "dead-reckoning", "--json", "--no-figures")
    assert done.status == 0 and "without the bound: truth.persisting_std is not what" in done.err
    (row,) = done.rows
    assert row["position_rmse_m"] > 0.0 and row["bound_position_rmse_m"] is None


def test_replay_without_truth_and_provenance(cellslam: Any, tmp_path: Path) -> None:
    cellslam("record", "tiny", "--out", "drive.h5")
    with h5py.File(tmp_path / "drive.h5", "r+") as file:
        del file["truth"]
        del file["provenance"]
        file["provenance"] = "{}"
        file["provenance"].attrs["unit"] = "JSON"
    done = cellslam("replay", "drive.h5", "--estimator", "dead-reckoning", "--json")
    assert done.status == 0
    (row,) = done.rows
    assert (row["scenario"], row["seed"], row["position_rmse_m"]) == ("drive", 0, None)
    assert (tmp_path / "results" / "replay-drive" / "summary.json").exists()


def test_what_an_earlier_run_left_does_not_stand_beside_another_summary(cellslam: Any, tmp_path: Path) -> None:
    folder = tmp_path / "results" / "tiny-0"
    cellslam("run", "tiny", "--estimator", "dead-reckoning", "--trials", "2")
    (folder / "mine.png").touch()
    assert {"map.png", "error.png", "trajectory-truth-1.tum"} <= {path.name for path in folder.iterdir()}
    cellslam("run", "tiny", "--estimator", "dead-reckoning", "--no-figures")
    assert {path.name for path in folder.iterdir() if path.suffix in (".png", ".tum")} == {
        "mine.png", "trajectory-dead-reckoning.tum", "trajectory-truth.tum",
    }  # fmt: skip


def test_own_estimator_from_the_current_directory(cellslam: Any, plugin: Path) -> None:
    done = cellslam("run", "tiny", "--estimator", "cli_plugin:Mine", "--estimator", "cli_plugin:Oracle", "--no-figures")
    assert done.status == 0
    assert "cli_plugin:Oracle (oracle)" in done.out and "cli_plugin:Mine " in done.out
    assert (plugin / "results" / "tiny-0" / "trajectory-cli_plugin_Mine.tum").exists()


def test_failing_estimator_gives_status_1_and_its_reason(cellslam: Any, plugin: Path) -> None:
    names = ("--estimator", "cli_plugin:Fails", "--estimator", "cli_plugin:Mine")
    done = cellslam("run", "tiny", *names, "--json", "--no-figures")
    assert done.status == 1
    assert [row["status"] for row in done.rows] == ["failed", "ok"]
    assert "ArithmeticError: lost it, snapshot 5" in done.rows[0]["error"]
    assert done.rows[0]["position_rmse_m"] is None
    assert "Traceback" in (plugin / "results" / "tiny-0" / "error-cli_plugin_Fails.txt").read_text()
    assert "(failed)" in cellslam("run", "tiny", *names, "--no-figures").out


def test_interrupt_leaves_what_is_finished(cellslam: Any, plugin: Path) -> None:
    done = cellslam("run", "tiny", "--trials", "3", "--estimator", "cli_plugin:Interrupted", "--json")
    assert done.status == 130
    assert [row["trial"] for row in done.rows] == [0]
    assert "1 of 3 trials are finished" in done.err and "cellslam run tiny --trials 3" in done.err
    summary = json.loads((plugin / "results" / "tiny-0" / "summary.json").read_text())
    assert [row["trial"] for row in summary["rows"]] == [0]


RUN = ("run", "tiny")
WRONG = {
    "scenario": (("run", "tinny"), ["unknown scenario 'tinny'", "did you mean 'tiny'"]),
    "scenario file": (("run", "no/such.toml"), ["no/such.toml: no such scenario file"]),
    "key": ((*RUN, "--set", "radio.laod=1"), ["unknown key 'radio.laod'", "'radio.load'"]),
    "value": ((*RUN, "--set", "radio.load=7"), ["radio.load = 7", "0 to 1"]),
    "no value": ((*RUN, "--set", "radio.load"), ["write KEY=VALUE"]),
    "particles": ((*RUN, "--set", "estimator.fastslam.particles=0"), ["particles = 0"]),
    "estimator": ((*RUN, "--estimator", "fastslm"), ["unknown estimator 'fastslm'", "'fastslam'"]),
    "module": ((*RUN, "--estimator", "no_such:X"), ["no module 'no_such'"]),
    "trials": ((*RUN, "--trials", "0"), ["trials = 0", "at least 1"]),
    "seed": ((*RUN, "--seed", "-1"), ["seed = -1", "0 or more"]),
    "text seed": ((*RUN, "--seed", "x"), ["--seed", "'x' is not a whole number"]),
    "out": ((*RUN, "--out", "/dev/null/x"), ["/dev/null", "not a folder"]),
    "site": ((*RUN, "--set", "sites.0.position_m=[0.0, 0.0]"), ["'sites.", "is missing"]),
    "mesh": (
        (*RUN, "--set", "city={kind='mesh', path='none.ply'}"),
        ["none.ply"],
    ),
    "command": (("rnu", "tiny"), ["unknown command 'rnu'", "did you mean 'run'"]),
    "option": ((*RUN, "--jsn"), ["--jsn"]),
    "list": (("list", "cities"), ["'cities'", "scenarios"]),
    "record": (("record", "tiny", "--out", "none/a.h5"), ["no folder none"]),
    "record trial": (("record", "tiny", "--out", "a.h5", "--trial", "-1"), ["trial = -1"]),
    "record options": (
        ("record", "tiny", "--out", "a.h5", "--set", "estimator.fastslam.particles=0"),
        ["particles = 0"],
    ),
    "replay": (("replay", "none.h5"), ["none.h5: no such file"]),
    "show": (("show", "tinny"), ["'tiny'"]),
}


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_request_is_one_line_and_leaves_nothing(cellslam: Any, tmp_path: Path, kind: str) -> None:
    words, expected = WRONG[kind]
    done = cellslam(*words)
    assert done.status == 2
    assert done.out == ""
    assert done.err.count("\n") == 1 and done.err.startswith("cellslam: "), done.err
    for text in expected:
        assert text in done.err
    assert left_over(tmp_path) == set()


def test_replay_refuses_what_a_recording_fixes(cellslam: Any, tmp_path: Path) -> None:
    cellslam("record", "tiny", "--out", "a.h5")
    done = cellslam("replay", "a.h5", "--set", "radio.load=0.1")
    assert done.status == 2 and "radio.load" in done.err
    (tmp_path / "a.h5").write_text("no")
    done = cellslam("replay", "a.h5")
    assert done.status == 2 and "a.h5: not an HDF5 file" in done.err
    assert left_over(tmp_path) == {"a.h5"}


def test_later_world_that_cannot_be_made_fails_its_rows(
    cellslam: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cellslam.benchmarks.trials import trials
    from cellslam.sim.errors import InputError

    real = trials.simulate

    def second_is_impossible(scenario: Any, seed: int, trial: int, **more: Any) -> Any:
        if trial == 1:
            raise InputError("no street is long enough")
        return real(scenario, seed, trial, **more)

    monkeypatch.setattr(trials, "simulate", second_is_impossible)
    done = cellslam("run", "tiny", "--estimator", "dead-reckoning", "--trials", "2", "--json", "--no-figures")
    assert done.status == 1
    assert [row["status"] for row in done.rows] == ["ok", "failed"]
    assert "no street is long enough" in done.rows[1]["error"]


def test_show_and_list(cellslam: Any) -> None:
    shown = cellslam("show", "tiny", "--set", "radio.load=0.125")
    assert shown.status == 0
    assert re.search(r"radio\.load +0\.125 +0 to 1 +share of other cells", shown.out)
    assert re.search(r"vehicle\.duration_s +[\d.]+ +s +above 0", shown.out)
    assert "estimator.fastslam.particles" in shown.out
    scenarios = cellslam("list", "scenarios")
    assert scenarios.status == 0 and "tiny" in scenarios.out
    estimators = cellslam("list", "estimators")
    assert "fastslam" in estimators.out and "dead-reckoning" in estimators.out


def test_quiet_and_verbose_stand_before_a_command_or_after_it(cellslam: Any) -> None:
    for words in (("--verbose", "show", "tinny"), ("show", "tinny", "--verbose")):
        assert "Traceback" in cellslam(*words).err
    assert "results are in" in cellslam(*RUN, "--no-figures").err
    assert cellslam("--quiet", *RUN, "--no-figures").err == cellslam(*RUN, "--no-figures", "--quiet").err == ""


def test_version(cellslam: Any) -> None:
    assert re.fullmatch(r"cellslam \d+\.\d+\.\d+\n", cellslam("--version").out)


def test_help_answers_within_a_third_of_a_second() -> None:
    def seconds() -> float:
        begin = time.perf_counter()
        done = subprocess.run([COMMAND, "--help"], capture_output=True, text=True, check=True)
        assert "usage: cellslam" in done.stdout
        return time.perf_counter() - begin

    assert min(seconds() for _ in range(5)) < 0.3


def test_installed_command_and_control_c(tmp_path: Path) -> None:
    words = [
        COMMAND,
        "run",
        "tiny",
        "--estimator",
        "dead-reckoning",
        "--trials",
        "100000",
        "--no-figures",
        "--json",
    ]
    process = subprocess.Popen(
        words,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    summary = tmp_path / "results" / "tiny-0" / "summary.json"
    killer = threading.Timer(60, process.kill)
    killer.start()
    while not summary.exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    killer.cancel()
    assert process.returncode == 130, err
    rows = json.loads(out)
    assert 0 < len(rows) == len(json.loads(summary.read_text())["rows"])
    assert "interrupted" in err and "Traceback" not in err


@pytest.fixture(scope="module")
def inside() -> tuple[float, float]:
    """A point in a building of `tiny`."""
    from cellslam.sim.city import build_city
    from cellslam.sim.randomness import Stream, stream

    config = load("tiny").world.city
    point = build_city(config, stream(config.seed, 0, Stream.CITY)).footprints[0].representative_point()
    return point.x, point.y


def assert_refused(done: Done, folder: Path, *words: str) -> None:
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1), done.err
    for word in words:
        assert word in done.err
    assert left_over(folder) == set()


def test_site_in_a_building(cellslam: Any, tmp_path: Path, inside: tuple[float, float]) -> None:
    place = f"sites.A.position_m=[{inside[0]}, {inside[1]}, 2.0]"
    assert_refused(cellslam("run", "tiny", "--quiet", "--set", place), tmp_path, "site", "'A'", "building")


def test_route_through_a_wall(cellslam: Any, tmp_path: Path, inside: tuple[float, float]) -> None:
    x, y = inside
    route = f"vehicle.waypoints_m=[[{x - 200}, {y}], [{x + 200}, {y}]]"
    assert_refused(cellslam("run", "tiny", "--quiet", "--set", route), tmp_path, "wall", "building")


@pytest.mark.parametrize("content", [None, b"", b"not a mesh", b"ply\nformat ascii 1.0\nend_header\n"])
def test_mesh_that_gives_no_city(
    cellslam: Any, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, content: bytes | None
) -> None:
    mesh = tmp_path_factory.mktemp("mesh") / "houses.ply"
    if content is not None:
        mesh.write_bytes(content)
    done = cellslam("run", "tiny", "--quiet", "--set", f"city={{kind='mesh', path='{mesh}'}}")
    assert_refused(done, tmp_path, "houses.ply")
