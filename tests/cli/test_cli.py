"""`cellslam run` end to end, on the preset `tiny`; requests that cannot be met."""

from __future__ import annotations

import json
import os
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
from cellslam.scenarios.loading import load
from cellslam.sim.city import build_city
from cellslam.sim.randomness import Stream, stream
from tests.command_line import PLUGIN, Run, refused
from tests.short_drive import SET, SHORT

COMMAND = Path(sys.executable).parent / "cellslam"
FEW = (*SHORT, "--set", "estimator.fastslam.particles=20")
ALONE = ("--estimator", "dead-reckoning")


def summary_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


@pytest.mark.slow
def test_run_prints_a_table_and_writes_the_results(cellslam: Run, tmp_path: Path) -> None:
    done = cellslam("run", "tiny", *FEW)
    names, folder = ("fastslam", "ekf-slam", "dead-reckoning"), tmp_path / "results" / "tiny-0"
    assert done.status == 0
    for word in (*names, "bound", "RMSE", "tiny, seed 0"):
        assert word in done.out
    assert "results/tiny-0" in done.err
    for line in done.err.split("worth trying next:\n")[1].splitlines():
        words = shlex.split(line.split("  ")[1])[1:]
        assert build_parser(words).parse_args(words).command
    summary = summary_of(folder)
    assert [row["estimator"] for row in summary["rows"]] == list(names)
    assert summary["command"] == f"cellslam run tiny {' '.join(FEW)}" and summary["versions"]["cellslam"]
    for name in (*names, "truth"):
        assert np.loadtxt(folder / f"trajectory-{name}.tum").shape == (summary["rows"][0]["snapshots"], 8)
    scenario = load(folder / "scenario.toml")
    assert scenario.name == "tiny" and scenario.world == load("tiny", SET).world
    assert scenario.estimator["fastslam"]["particles"] == 20
    for figure in ("map", "error", "associations", "clock_offsets"):
        assert (folder / f"{figure}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_what_an_earlier_run_left_does_not_stand_beside_another_summary(cellslam: Run, tmp_path: Path) -> None:
    folder = tmp_path / "results" / "tiny-0"
    cellslam("run", "tiny", *SHORT, *ALONE, "--trials", "2")
    (folder / "mine.png").touch()
    assert {"map.png", "trajectory-truth-1.tum"} <= {path.name for path in folder.iterdir()}
    again = cellslam("run", "tiny", *SHORT, *ALONE, "--no-figures", "--quiet", "--json")
    assert again.err == "" and "NaN" not in again.out and again.rows == summary_of(folder)["rows"]
    assert tuple(again.rows[0]) == ROW_KEYS
    left = {path.name for path in folder.iterdir() if path.suffix in (".png", ".tum")}
    assert left == {"mine.png", "trajectory-dead-reckoning.tum", "trajectory-truth.tum"}


def test_own_estimators_from_the_current_directory(cellslam: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "cli_plugin", raising=False)
    Path("cli_plugin.py").write_text(PLUGIN)
    done = cellslam("run", "tiny", "--estimator", "cli_plugin:Mine", "--estimator", "cli_plugin:Oracle", "--no-figures")
    assert done.status == 0
    assert "cli_plugin:Oracle (oracle)" in done.out and " mine " in done.out
    assert Path("results/tiny-0/trajectory-mine.tum").exists()


@pytest.mark.slow
def test_installed_command_and_control_c(tmp_path: Path) -> None:
    words = [COMMAND, "run", "tiny", *ALONE, "--trials", "100000", "--no-figures", "--json"]
    pipes, environment = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}, os.environ | {"COLUMNS": "80"}
    process = subprocess.Popen(words, cwd=tmp_path, text=True, env=environment, **pipes)
    summary = tmp_path / "results" / "tiny-0" / "summary.json"
    killer = threading.Timer(300, process.kill)
    killer.start()
    while not summary.exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    killer.cancel()
    assert process.returncode == 130, err
    assert 0 < len(json.loads(out)) == len(summary_of(summary.parent)["rows"])
    assert "interrupted" in err and "Traceback" not in err


RUN, RECORD = ("run", "tiny"), ("record", "tiny", "--out", "a.h5")
WRONG: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "scenario": (("run", "tinny"), ("unknown scenario 'tinny'", "did you mean 'tiny'")),
    "key": ((*RUN, "--set", "radio.laod=1"), ("unknown key 'radio.laod'", "'radio.load'")),
    "estimator": ((*RUN, "--estimator", "fastslm"), ("unknown estimator 'fastslm'", "'fastslam'")),
    "module": ((*RUN, "--estimator", "no_such:X"), ("no module 'no_such'",)),
    "trials": ((*RUN, "--trials", "0"), ("trials = 0", "at least 1")),
    "seed": ((*RUN, "--seed", "-1"), ("seed = -1", "0 or more")),
    "out": ((*RUN, "--out", "/dev/null/x"), ("/dev/null", "not a folder")),
    "mesh": ((*RUN, "--set", "city={kind='mesh', path='none.ply'}"), ("none.ply",)),
    "record": (("record", "tiny", "--out", "none/a.h5"), ("no folder none",)),
    "replay": (("replay", "none.h5"), ("none.h5: no such file",)),
    "snapshot": (("bench", "snapshot", "tiny", "--at", "100000"), ("the drive has snapshots 0 to",)),
    "picture": (("bench", "snapshot", "tiny", "--out", "a.pdf"), ("give the name of a .png file",)),
}


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_request_is_one_line_and_leaves_nothing(cellslam: Run, tmp_path: Path, kind: str) -> None:
    words, texts = WRONG[kind]
    refused(cellslam(*words, "--quiet"), *texts)
    assert list(tmp_path.iterdir()) == []


def test_sites_and_routes_in_buildings_are_refused(cellslam: Run, tmp_path: Path) -> None:
    config = load("tiny").world.city
    point = build_city(config, stream(config.seed, 0, Stream.CITY)).footprints[0].representative_point()
    x, y = point.x, point.y
    site, route = f"sites.A.position_m=[{x}, {y}, 2.0]", f"vehicle.waypoints_m=[[{x - 200}, {y}], [{x + 200}, {y}]]"
    refused(cellslam("run", "tiny", "--quiet", "--set", site), "site", "'A'", "building")
    refused(cellslam("run", "tiny", "--quiet", "--set", route), "wall", "building")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_picture_of_a_snapshot(cellslam: Run) -> None:
    assert "true paths" in cellslam("bench", "snapshot", "tiny", "--at", 3, "--out", "one.png", "--quiet").out
    assert Path("one.png").stat().st_size > 10_000
