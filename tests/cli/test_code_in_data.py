"""Files from elsewhere that name code: it runs only where the user asks for it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.bound.persisting_states import radio_of
from cellslam.benchmarks.sweeps.tasks import Job, Plan, Task, canonical, identity
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.scenarios.loading import load
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError
from cellslam.sim.lte.statistical.statistics import file_of
from cellslam.sim.recording import Recording
from tests.benchmarks.made_up_sweeps import made_up, plan_of, trajectory
from tests.command_line import Run, refused
from tests.short_drive import SHORT

EVIL = """
from pathlib import Path
from pydantic import BaseModel
from cellslam.slam.fastslam.parts import BUILT_IN
Path("ran").touch()
class W:
    class Options(BaseModel):
        evil_option: int
    def start(self, setup, rng): pass
    def step(self, dt_s, odometry, snapshot): pass
part = BUILT_IN["association"]["nearest-neighbour"]
def loss(*given): return 0.0 * sum(given)
"""
WORLD = """
[city]
kind = "procedural"
[[sites]]
name = "A"
cells = [{ cell_id = 1 }]
[vehicle]
route = 1
distance_m = 40.0
duration_s = 60.0
stops = 1
"""
REPLAY = ("replay", "drive.h5", "--estimator", "dead-reckoning", "--estimator", "fastslam", "--no-figures")


@pytest.fixture
def ran(cellslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], bool]:
    """Whether `evil`, a module that Python would find, was imported."""
    (tmp_path / "evil.py").write_text(EVIL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("cellslam.sim.own_code._LOADED", {})
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    return lambda: (tmp_path / "ran").exists()


def saying(recording: Recording, radio: dict[str, Any], fastslam: dict[str, Any]) -> Recording:
    """Return a recording whose provenance names `tiny`, with these keys."""
    tables = {**load("tiny").resolved, "estimator": {"fastslam": fastslam}}
    tables["radio"] |= radio
    assert recording.truth is not None
    truth = replace(recording.truth, persisting_std=np.full((len(recording.measurements), 3), 0.1))
    return replace(recording, truth=truth, provenance={"scenario": tables, "world": {"radio": tables["radio"]}})


def test_a_waveform_that_a_recording_names_is_not_loaded(
    toy_recording: Callable[..., Recording], ran: Callable[[], bool], cellslam: Run
) -> None:
    odd = saying(toy_recording(), {"technology": "evil:W", "front_end": "signal"}, {})
    odd.save("drive.h5")
    refused(cellslam(*REPLAY), "names code, radio.technology = 'evil:W'", "--set radio.technology=evil:W")
    refused(cellslam(*REPLAY, "--set", "radio.technology=lte"), "a recording is as it is, with 'evil:W'")
    with pytest.raises(InputError, match=r"names code, radio\.technology"):
        radio_of(odd)
    assert Origin.of(odd).scenario is None and not ran()
    Origin.of(odd, given={"radio.technology": "evil:W"})
    assert ran()


def test_a_part_that_a_recording_names_is_not_loaded(
    toy_recording: Callable[..., Recording], ran: Callable[[], bool], cellslam: Run
) -> None:
    odd, key = saying(toy_recording(), {}, {"association": "evil:part"}), "estimator.fastslam.association"
    odd.save("drive.h5")
    refused(cellslam(*REPLAY), f"names code, {key} = 'evil:part'", f"--set {key}=evil:part")
    touched = ("--set", "estimator.fastslam.particles=10")  # also where it is only looked at
    refused(cellslam(*REPLAY[:4], *touched), f"names code, {key}")
    origin = Origin.of(odd)
    assert origin.scenario is not None and origin.assumed() == {}
    assert [r.name for r in assumed(odd, origin, ("dead-reckoning",), {}).requests] == ["dead-reckoning"] and not ran()
    assumed(odd, origin, ("fastslam",), {key: "evil:part"})
    assert ran()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "name", "bound"),
    [("radio.path_loss", "evil:loss", True), ("radio.statistics_file", "mine.json", False)],
)
def test_own_parts_of_the_world_are_used_where_they_are_given_again(
    ran: Callable[[], bool], cellslam: Run, monkeypatch: pytest.MonkeyPatch, key: str, name: str, bound: bool
) -> None:
    Path("mine.json").write_text(file_of().read_text())
    assert cellslam("record", "tiny", *SHORT, "--set", f"{key}={name}", "--out", "drive.h5").status == 0
    monkeypatch.setattr("cellslam.sim.own_code._LOADED", {})
    monkeypatch.setattr("cellslam.sim.own_code._READ", set())
    sys.modules.pop("evil", None)
    Path("ran").unlink(missing_ok=True)
    again, replay = ("--set", f"{key}={name}"), ("replay", "drive.h5", "--estimator", "dead-reckoning")
    refused(cellslam(*replay, "--set", f"{key}=other"), f"{key}=other: a recording is as it is, with '{name}'")
    done = cellslam(*replay)
    assert done.status == 0 and ("bound" in done.out) == bound and not ran()
    assert f"without the city in figures: the recording names {'code' if bound else 'a file'}, {key}" in done.err
    assert f"give it again: --set {key}={name}" in done.err
    assert ("without the bound" in done.err) != bound
    for words in (replay, (*replay, "--fit"), ("inspect", "drive.h5", "--estimator", "dead-reckoning")):
        done = cellslam(*words, *again)
        assert done.status == 0 and "without" not in done.err, done.err
        assert "bound" in done.out or words[0] == "inspect"
    assert ran() == bound
    assert cellslam("fit-noise", "drive.h5").status == 0  # needs none of it


@pytest.mark.slow
def test_to_show_a_scenario_runs_nothing(ran: Callable[[], bool], cellslam: Run) -> None:
    own = '[estimator."evil:W"]\nevil_option = 3\n[estimator.fastslam]\nassociation = "evil:part"\n'
    Path("place.toml").write_text(f'{WORLD}[radio]\ntechnology = "evil:W"\nfront_end = "signal"\n{own}')
    done = cellslam("show", "place.toml")
    assert done.status == 0 and not ran()
    assert "evil:part" in done.out and "evil_option" not in done.out
    assert (
        "not loaded, as it is code or a file: radio.technology, estimator.fastslam.association, estimator.evil:W"
        in done.err
    )
    for command in (("city", "inspect", "place.toml"), ("init", "place.toml", "--out", "own.toml", "--no-figures")):
        assert cellslam(*command).status == 0 and not ran()
    assert str(Path.cwd()) not in sys.path[1:]
    Path("place.toml").write_text(WORLD + own)
    done = cellslam("show", "place.toml", "--load", "--quiet")
    assert done.status == 0 and ran() and "estimator.evil:W.evil_option" in done.out, done.err


@pytest.mark.slow
def test_to_look_at_results_runs_nothing(ran: Callable[[], bool], cellslam: Run) -> None:
    def named(task: Task, job: Job) -> dict[str, Any]:
        return {"estimator": "evil:W" if job.oracle else job.estimator, "position_rmse_m": 1.0 + task.trial}

    plan = plan_of({}, ("dead-reckoning", "oracle-map"), trials=3)
    world = json.loads(plan.tasks[0].world)
    world["radio"] |= {"technology": "evil:W", "front_end": "signal"}
    text = canonical(world)
    tasks = tuple(replace(task, world=text) for task in plan.tasks)
    own = Plan(tasks, {identity(text): text}, plan.options)
    made_up(Path("results"), own, named, lambda *_: trajectory())
    for command in ("table", "consistency", "figures", "report"):
        done = cellslam(command, "results", *(("--rows", "estimator") if command == "table" else ()))
        assert done.status == 0, done.err
        assert "evil:W (oracle)" in done.out or command in ("figures", "report")
    assert not ran() and str(Path.cwd()) not in sys.path[1:]
    assert (
        "it names code, radio.technology = 'evil:W', which 'report --load' loads"
        in Path("results/report.html").read_text()
    )
    cellslam("report", "results", "--load")
    assert ran() and "radio.technology 'evil:W' cannot be made" in Path("results/report.html").read_text()
