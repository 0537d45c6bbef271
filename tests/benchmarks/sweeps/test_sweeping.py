"""`cellslam sweep` end to end: executors, estimators that misbehave, kills, resuming."""

from __future__ import annotations

import os
import signal
import sqlite3
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from cellslam.benchmarks.bound import merged_paths
from cellslam.benchmarks.sweeps import executors, sweeping, tasks
from cellslam.benchmarks.sweeps.executors import Pool
from cellslam.benchmarks.sweeps.store import DATABASE, TRAJECTORIES, writing
from cellslam.benchmarks.sweeps.tasks import Task
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.cli.main import main
from cellslam.scenarios import simulation
from cellslam.sim.errors import InputError
from tests.benchmarks.made_up_sweeps import plan_of
from tests.benchmarks.sweeps.short_sweeps import rows, start, stored, wait_for, words
from tests.benchmarks.trials.hostile_estimators import MISFITS
from tests.command_line import Run, refused
from tests.short_drive import SET


@pytest.mark.slow
def test_processes_give_the_rows_of_one_process(place: Path) -> None:
    swept = ("--sweep", "radio.load=0.1,1", "--sweep", "estimator.fastslam.particles=10,20")
    for name in ("serial", "processes"):
        more = (*swept, "--executor", name, "--jobs", "2")
        assert main(words("fastslam", "dead-reckoning", out=name, more=more)) == 0
    expected = rows("serial")
    assert len(expected) == 2 * 2 * 3 and {row["status"] for row in expected} == {"ok"}
    assert rows("processes") == expected
    files = [sorted(p.name for p in Path(name, TRAJECTORIES).rglob("*.npz")) for name in ("serial", "processes")]
    assert files[0] == files[1] == sorted(f"{row['key']}.npz" for row in expected)


@pytest.mark.slow
def test_what_failed_is_done_again_when_that_is_asked_for(place: Path) -> None:
    """Which kinds of misfits cost their own rows only: test_hostile.py."""
    names = [f"misfits:{name}" for name in ("Hangs", "Exits", "Good")]
    assert main(words(*names, trials=1, more=("--time-limit", "5", "--jobs", "1"))) == 1
    found = {row["estimator"].removeprefix("misfits:"): row for row in rows("out")}
    assert found["Hangs"]["error"] == "no answer within the time limit of 5 s; alone it was lost again"
    assert found["Exits"]["error"] == "its process ended with exit status 7; alone it was lost again"
    (place / "misfits.py").write_text(MISFITS.replace("NOW = 5", "NOW = -1"))
    tasks._request_of.cache_clear()
    assert main(words(*names, trials=1, more=("--executor", "serial"))) == 1
    assert {row["estimator"].removeprefix("misfits:"): row for row in rows("out")} == found
    assert main(words(*names, trials=1, more=("--executor", "serial", "--retry-failed"))) == 0
    assert {row["position_rmse_m"] for row in rows("out")} == {found["good"]["position_rmse_m"]}


def test_what_is_lost_once_is_done_alone(place: Path) -> None:
    made, asked = plan_of({"set": SET}, ("misfits:Good", "dead-reckoning")), []

    with writing(place / "out", "test", {}) as store, executors.executor("serial", 1, Limits(60, 2**31)) as serial:

        def unlucky(wanted: Any) -> Any:
            asked.append([job.estimator for task in wanted for job in task.jobs])
            for task in wanted:
                lost = task.jobs[0]
                if len(asked) == 1:
                    yield tasks.Lost(task, lost, "killed")
                yield from serial([task.without(lost.key) if len(asked) == 1 else task])

        sweeping.carry_out(made, store, unlucky, lambda *_: None)
    assert asked == [["good", "dead-reckoning"], ["good"]]
    assert {row["estimator"]: row["status"] for row in rows("out")} == dict.fromkeys(asked[0], "ok")


def test_a_world_is_made_once_for_all_estimators(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, real = list[tuple[int, float]](), simulation.simulate

    def simulate(scenario: Any, seed: int, trial: int) -> Any:
        made.append((trial, scenario.radio.load))
        return real(scenario, seed, trial)

    monkeypatch.setattr(simulation, "simulate", simulate)
    names = ("misfits:Good", "misfits:SystemExits", "dead-reckoning")
    assert main(words(*names, more=("--executor", "serial", "--sweep", "radio.load=0.1,0.2"))) == 1
    assert made == [(0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)]


def test_a_bound_that_cannot_be_computed_leaves_nulls_and_a_note(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(*_: Any) -> None:
        raise ArithmeticError("singular")

    monkeypatch.setattr(merged_paths, "both_bounds", singular)
    assert main(words("dead-reckoning", trials=1, more=("--executor", "serial"))) == 0
    (row,) = rows("out")
    assert row["position_rmse_m"] > 0.0 and row["bound_position_rmse_m"] is None
    with sqlite3.connect(place / "out" / DATABASE) as database:
        (note,) = database.execute("SELECT traceback FROM rows").fetchone()
    database.close()
    assert note.startswith("without the bound: ArithmeticError: singular")


@pytest.mark.slow
def test_control_c_says_how_to_go_on(place: Path) -> None:
    driver = start(words("misfits:Slow", trials=500, more=("--jobs", "1")))
    wait_for(lambda: stored(place / "out") > 0, driver)
    driver.send_signal(signal.SIGINT)
    _, err = driver.communicate(timeout=60)
    assert driver.returncode == 130, err
    assert "Traceback" not in err and "are kept in out" in err
    assert 0 < stored(place / "out") < 500


def test_workers_that_do_not_start_are_one_line(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with Pool(2, Limits(60, 2**31)) as pool, pytest.raises(InputError, match="worker processes do not start"):
        list(pool.run(plan_of({}, trials=2).tasks))


class Deadly(Task):
    """A task that ends the process that reads it."""

    def __reduce__(self) -> Any:
        return os._exit, (1,)


@pytest.mark.slow
def test_workers_that_die_before_they_begin_are_not_replaced_for_ever(place: Path) -> None:
    deadly = [Deadly(**vars(task)) for task in plan_of({}, trials=2).tasks]
    with Pool(2, Limits(60, 2**31)) as pool, pytest.raises(InputError, match="worker processes do not start"):
        list(pool.run(deadly))


@pytest.mark.slow
def test_a_pool_can_be_left_where_a_worker_was_lost(place: Path) -> None:
    names = ("dead-reckoning", "misfits:Hangs")
    with pytest.raises(ZeroDivisionError), Pool(1, Limits(60, 2**31)) as pool:
        for answer in pool.run(plan_of({"set": SET}, names).tasks):
            if isinstance(answer, tasks.Lost):
                assert answer.job.estimator == names[1] and "its worker process was killed by SIGKILL" in answer.reason
                raise ZeroDivisionError
            time.sleep(1.0)  # the next job begins
            pool._workers[0].process.kill()


@pytest.mark.slow
def test_dry_run_counts_estimates_and_writes_nothing(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    more = ("--dry-run", "--sweep", "radio.load=0.1,0.2", "--sweep", "estimator.fastslam.particles=5,6,7")
    assert main([*words("fastslam", "dead-reckoning", trials=10), *more]) == 0
    out = capfd.readouterr().out
    assert "6 points, 20 worlds, 80 rows\n" in out
    assert "one trial, timed now: world" in out and "fastslam" in out
    assert {path.name for path in place.iterdir()} <= {"misfits.py", "__pycache__"}


SWEEP = ("sweep", "tiny", "--estimator", "dead-reckoning", "--out", "out")
WRONG = {
    "no out": (("sweep", "tiny"), "--out"),
    "key": ((*SWEEP, "--sweep", "radio.laod=1"), "unknown key 'radio.laod'"),
    "form": ((*SWEEP, "--sweep", "radio.load"), "write KEY=VALUE"),
    "jobs": ((*SWEEP, "--jobs", "0"), "--jobs 0: must be at least 1"),
    "time": ((*SWEEP, "--time-limit", "0"), "--time-limit 0: must be above 0"),
    "memory": ((*SWEEP, "--memory-limit", "-1"), "--memory-limit -1"),
    "scheduler": ((*SWEEP, "--scheduler", "tcp://x:1"), "--scheduler is for --executor dask"),
    "folder": ((*SWEEP[:-1], "/dev/null/x"), "not a folder"),
    "both": ((*SWEEP, "--set", "radio.load=1", "--sweep", "radio.load=1"), "swept, and set"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_request_is_one_line_and_leaves_nothing(tmp_path: Path, cellslam: Run, kind: str) -> None:
    line, expected = WRONG[kind]
    refused(cellslam(*line), expected)
    assert not list(tmp_path.iterdir())
