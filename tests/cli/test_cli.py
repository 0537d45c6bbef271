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
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.cli.main import build_parser
from cellslam.scenarios import load
from tests.short_drive import SET, SHORT

COMMAND = Path(sys.executable).parent / "cellslam"
FEW = (*SHORT, "--set", "estimator.fastslam.particles=20")

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


@pytest.fixture
def plugin(cellslam: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delitem(sys.modules, "cli_plugin", raising=False)
    (tmp_path / "cli_plugin.py").write_text(PLUGIN)
    return tmp_path


def left_over(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"cli_plugin.py", "__pycache__"}


@pytest.mark.slow
def test_run_prints_a_table_and_writes_the_results(cellslam: Any, tmp_path: Path) -> None:
    done = cellslam("run", "tiny", *FEW)
    assert done.status == 0
    for word in ("fastslam", "ekf-slam", "dead-reckoning", "bound", "RMSE", "tiny, seed 0"):
        assert word in done.out
    assert "results/tiny-0" in done.err
    next_ones = [line.split("  ")[1] for line in done.err.split("worth trying next:\n")[1].splitlines()]
    assert [line.split()[1] for line in next_ones] == ["report", "run", "run"]
    for line in next_ones:
        words = shlex.split(line)[1:]
        assert build_parser(words).parse_args(words).command
    folder = tmp_path / "results" / "tiny-0"
    summary = json.loads((folder / "summary.json").read_text())
    assert [row["estimator"] for row in summary["rows"]] == ["fastslam", "ekf-slam", "dead-reckoning"]
    assert summary["command"] == f"cellslam run tiny {' '.join(FEW)}"
    assert summary["versions"]["cellslam"]
    snapshots = summary["rows"][0]["snapshots"]
    for name in ("fastslam", "ekf-slam", "dead-reckoning", "truth"):
        assert np.loadtxt(folder / f"trajectory-{name}.tum").shape == (snapshots, 8)
    scenario = load(folder / "scenario.toml")
    assert scenario.name == "tiny"
    assert scenario.estimator["fastslam"]["particles"] == 20
    assert scenario.world == load("tiny", SET).world
    for figure in ("map", "error", "associations", "clock_offsets"):
        assert (folder / f"{figure}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_json_is_one_array_and_nothing_else(cellslam: Any, tmp_path: Path) -> None:
    done = cellslam("run", "tiny", *FEW, "--json", "--trials", "2", "--seed", "3", "--no-figures", "--out", "here")
    rows = done.rows
    assert done.status == 0
    names = ("fastslam", "ekf-slam", "dead-reckoning")
    assert [(row["trial"], row["estimator"]) for row in rows] == [(trial, name) for trial in (0, 1) for name in names]
    for row in rows:
        assert tuple(row) == ROW_KEYS
        assert (row["scenario"], row["seed"], row["status"], row["error"]) == ("tiny", 3, "ok", None)
        assert row["realtime_factor"] == pytest.approx(row["duration_s"] / row["estimate_seconds"])
    assert "NaN" not in done.out and "Infinity" not in done.out
    assert rows[2]["clock_offset_rmse_m"] is None
    assert rows[0]["position_rmse_m"] != rows[3]["position_rmse_m"]
    assert json.loads((tmp_path / "here" / "summary.json").read_text())["rows"] == rows
    assert (tmp_path / "here" / "trajectory-fastslam-1.tum").exists()
    assert not list((tmp_path / "here").glob("*.png"))


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_quiet_and_verbose_stand_before_a_command_or_after_it(cellslam: Any) -> None:
    for words in (("--verbose", "show", "tinny"), ("show", "tinny", "--verbose")):
        assert "Traceback" in cellslam(*words).err
    short = (*RUN, *SHORT, "--no-figures")
    assert "results are in" in cellslam(*short).err
    assert cellslam("--quiet", *short).err == cellslam(*short, "--quiet").err == ""


def test_version(cellslam: Any) -> None:
    assert re.fullmatch(r"cellslam \d+\.\d+\.\d+\n", cellslam("--version").out)


def test_help_answers_within_a_third_of_a_second() -> None:
    def seconds() -> float:
        begin = time.perf_counter()
        done = subprocess.run([COMMAND, "--help"], capture_output=True, text=True, check=True)
        assert "usage: cellslam" in done.stdout
        return time.perf_counter() - begin

    assert min(seconds() for _ in range(5)) < 0.3


@pytest.mark.slow
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


def assert_refused(done: Any, folder: Path, *words: str) -> None:
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
