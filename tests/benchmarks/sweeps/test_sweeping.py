"""`cellslam sweep` end to end: executors, estimators that misbehave, kills, resuming."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from cellslam.benchmarks.cli.main import main
from cellslam.benchmarks.scores.trial_result import COST_KEYS, ROW_KEYS
from cellslam.benchmarks.sweeps import executors, sweeping, tasks
from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.store import DATABASE, TRAJECTORIES, writing
from cellslam.benchmarks.sweeps.worker_pool import Pool
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.scenarios import sweep_points as sweep
from cellslam.sim.errors import InputError

COMMAND = Path(sys.executable).parent / "cellslam"
SET = {"vehicle.distance_m": 5, "vehicle.duration_s": 7.5, "vehicle.stops": 0, "vehicle.stand_first_s": 0}
SHORT = tuple(word for key, value in SET.items() for word in ("--set", f"{key}={value}"))
# How often driver and workers are killed; the full test: CELLSLAM_KILLS=20 pytest
# tests/benchmarks/sweeps/test_sweeping.py -k kill
KILLS = int(os.environ.get("CELLSLAM_KILLS", "1"))
TRIALS = 3 + 2 * KILLS
PLUGIN = """
import os, time
import numpy as np
from cellslam.sim.frames import integrate_pose
from cellslam.slam.api import Estimate

class Good:
    name = "good"
    def __init__(self, options): pass
    def start(self, setup, rng):
        self.pose, self.rng = setup.start_pose, rng
    def step(self, dt_s, odometry, snapshot):
        self.pose = integrate_pose(self.pose, odometry, dt_s)
        self.odd(snapshot.index == 5)
        return Estimate(self.pose + 0.01 * self.rng.normal(size=6), np.eye(6))
    def odd(self, now): pass

class Slow(Good):
    def odd(self, now): time.sleep(0.004)

class Raises(Good):
    def odd(self, now):
        if now: raise ArithmeticError("lost it")

class Hangs(Good):
    def odd(self, now):
        while now: time.sleep(0.1)

class NotFinite(Good):
    def odd(self, now):
        if now: self.pose = self.pose * np.nan

class EatsMemory(Good):
    def odd(self, now):
        self.eaten = [np.empty(10**8) for _ in range(100 if now else 0)]

class Exits(Good):
    def odd(self, now):
        if now: os._exit(7)
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "misfits", raising=False)
    tasks.request_of.cache_clear()
    (tmp_path / "misfits.py").write_text(PLUGIN)
    return tmp_path


def words(*estimators: str, out: str = "out", trials: int = 2, more: tuple[str, ...] = ()) -> list[str]:
    chosen = [word for name in estimators for word in ("--estimator", name)]
    return ["sweep", "tiny", *SHORT, *chosen, "--trials", str(trials), "--out", out, "--quiet", *more]


def rows(out: str | Path) -> list[dict[str, Any]]:
    """Return the rows of a store without their times, in an order of their own."""
    kept = [key for key in ROW_KEYS if key not in COST_KEYS]
    with sqlite3.connect(Path(out) / DATABASE) as database:
        found = database.execute(f"SELECT key, {', '.join(kept)} FROM rows ORDER BY key").fetchall()
    database.close()
    return [dict(zip(("key", *kept), row, strict=True)) for row in found]


def test_processes_give_the_rows_of_one_process(place: Path) -> None:
    swept = ("--sweep", "radio.load=0.1,1", "--sweep", "estimator.fastslam.particles=10,20")
    names = ("fastslam", "dead-reckoning")
    for name in ("serial", "processes"):
        more = (*swept, "--executor", name, "--jobs", "2")
        assert main(words(*names, out=name, more=more)) == 0
    expected = rows("serial")
    assert len(expected) == 2 * 2 * 3
    assert {row["status"] for row in expected} == {"ok"}
    assert rows("processes") == expected
    files = [sorted(p.name for p in Path(name, TRAJECTORIES).rglob("*.npz")) for name in ("serial", "processes")]
    assert files[0] == files[1] == sorted(f"{row['key']}.npz" for row in expected)
    frame = results(place / "processes")
    assert frame.groupby("estimator", dropna=False)["estimator.fastslam.particles"].nunique().to_dict() == {
        "dead-reckoning": 0,
        "fastslam": 2,
    }


def test_misfits_cost_their_own_rows_only(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    names = [f"misfits:{name}" for name in ("Raises", "Hangs", "NotFinite", "EatsMemory", "Exits", "Good")]
    more = ("--time-limit", "2", "--memory-limit", "1.5", "--jobs", "1")
    assert main(words(*names, trials=1, more=more)) == 1
    found = {row["estimator"].removeprefix("misfits:"): row for row in rows("out")}
    errors = {name: row["error"] for name, row in found.items()}
    assert "ArithmeticError: lost it, snapshot 5" in errors["Raises"]
    assert errors["Hangs"] == "no answer within the time limit of 2 s; alone it was lost again"
    assert "pose is not finite, snapshot 5" in errors["NotFinite"]
    assert "MemoryError" in errors["EatsMemory"]
    assert errors["Exits"] == "its process ended with exit status 7; alone it was lost again"
    before = [row for row in rows("out") if row["status"] == "ok"]
    assert before == [found["Good"]]
    # Resumed, nothing is done again; with --retry-failed what failed is.
    (place / "misfits.py").write_text(PLUGIN.replace("snapshot.index == 5", "False"))
    assert "misfits" not in sys.modules
    tasks.request_of.cache_clear()
    assert main(words(*names, trials=1, more=("--executor", "serial"))) == 1
    assert sum(row["status"] == "failed" for row in rows("out")) == 5
    assert main(words(*names, trials=1, more=("--executor", "serial", "--retry-failed"))) == 0
    assert {row["position_rmse_m"] for row in rows("out")} == {before[0]["position_rmse_m"]}
    capfd.readouterr()


def test_what_is_lost_once_is_done_alone(place: Path) -> None:
    made = tasks.plan(
        sweep.points(sweep.from_tables({"scenario": "tiny", "set": SET}), ("misfits:Good", "dead-reckoning")), 1, 0
    )
    asked = []

    class Unlucky(executors.Serial):
        def run(self, wanted: Any) -> Any:
            asked.append([job.estimator for task in wanted for job in task.jobs])
            for task in wanted:
                lost = task.jobs[0]
                if len(asked) == 1:
                    yield tasks.Lost(task, lost, "killed")
                yield from super().run([task.without(lost.key) if len(asked) == 1 else task])

    with writing(place / "out", "test", {}) as store, Unlucky(Limits(60, 2**31)) as unlucky:
        sweeping.carry_out(made, store, unlucky, lambda *_: None)
    assert asked == [["misfits:Good", "dead-reckoning"], ["misfits:Good"]]
    assert {(row["estimator"], row["status"]) for row in rows("out")} == {
        ("misfits:Good", "ok"),
        ("dead-reckoning", "ok"),
    }


def test_a_world_is_made_once_for_all_estimators(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cellslam.scenarios import simulation

    made: list[tuple[int, float]] = []
    real = simulation.simulate
    monkeypatch.setattr(
        simulation,
        "simulate",
        lambda s, seed, trial, *more: made.append((trial, s.radio.load)) or real(s, seed, trial, *more),
    )
    names = ("misfits:Good", "misfits:Raises", "dead-reckoning")
    assert main(words(*names, more=("--executor", "serial", "--sweep", "radio.load=0.1,0.2"))) == 1
    assert made == [(0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)]


def test_a_world_that_cannot_be_made_fails_its_rows(place: Path) -> None:
    more = ("--sweep", "vehicle.acceleration_mps2=0.6,0.05", "--executor", "serial")
    assert main(words("dead-reckoning", trials=1, more=more)) == 1
    failed = [row for row in rows("out") if row["status"] == "failed"]
    assert len(failed) == 1 and failed[0]["error"].startswith("the world cannot be made: ")


def test_a_bound_that_cannot_be_computed_leaves_nulls_and_a_note(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cellslam.benchmarks.bound import merged_paths

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


def start(line: list[str], **more: Any) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([COMMAND, *line], stdout=pipe, stderr=pipe, text=True, start_new_session=True, **more)


def stored(out: Path) -> int:
    try:
        with sqlite3.connect(f"file:{out / DATABASE}?mode=ro", uri=True) as database:
            count: int = database.execute("SELECT count(*) FROM rows").fetchone()[0]
        database.close()
    except sqlite3.OperationalError:
        return 0
    return count


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str], limit_s: float = 120.0) -> None:
    end = time.monotonic() + limit_s
    while not condition() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "misfits.py").write_text(PLUGIN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", list(sys.path))
        tasks.request_of.cache_clear()
        assert main(words("misfits:Slow", "dead-reckoning", trials=TRIALS, more=("--executor", "serial"))) == 0
    return rows(folder / "out")


def test_kills_lose_at_most_what_was_in_flight(place: Path, undisturbed: list[dict[str, Any]]) -> None:
    """A worker, then the driver, are killed at random moments, again and again; what is resumed ends undisturbed."""
    draw, kills, stores = random.Random(5), {"worker": 0, "driver": 0}, 0
    while kills["driver"] < KILLS:
        out = f"out{stores}"
        stores += 1
        line = words("misfits:Slow", "dead-reckoning", out=out, trials=TRIALS, more=("--jobs", "2", "--retry-failed"))
        while kills["driver"] < KILLS and stored(place / out) < len(undisturbed):
            _kill_once(start(line), place / out, draw, kills, undisturbed)
        last = start(line)
        _, err = last.communicate(timeout=400)
        assert last.returncode == 0, err
        assert rows(out) == undisturbed
        assert len(list(Path(out, TRAJECTORIES).rglob("*.npz"))) == len(undisturbed)
    assert kills["driver"] == KILLS and kills["worker"] > 0


def _kill_once(
    driver: subprocess.Popen[str],
    out: Path,
    draw: random.Random,
    kills: dict[str, int],
    undisturbed: list[dict[str, Any]],
) -> None:
    """Kill a worker, then the driver; every row that was seen before is still there, and right."""
    if draw.random() < 0.75:
        goal = stored(out) + 1
        wait_for(lambda: stored(out) >= goal, driver)
        time.sleep(draw.uniform(0.0, 0.2))
    else:
        time.sleep(draw.uniform(0.0, 4.0))
    workers = psutil.Process(driver.pid).children() if driver.poll() is None else []
    if workers:
        draw.choice(workers).kill()
        kills["worker"] += 1
        time.sleep(draw.uniform(0.0, 0.5))
    seen = stored(out)
    kills["driver"] += driver.poll() is None
    driver.kill()
    driver.communicate()
    kept = rows(out) if stored(out) else []
    assert len(kept) >= seen
    assert all(row in undisturbed or "SIGKILL" in row["error"] for row in kept)


@pytest.mark.skipif(
    KILLS == 1, reason="a long test: CELLSLAM_KILLS=20 pytest tests/benchmarks/sweeps/test_sweeping.py -k kill"
)
def test_killed_workers_cost_nothing(place: Path, undisturbed: list[dict[str, Any]]) -> None:
    draw, kills, sweeps = random.Random(6), 0, 0
    line = ("--jobs", "2", "--retry-failed")
    while kills < KILLS:
        out = f"out{sweeps}"
        sweeps += 1
        driver = start(words("misfits:Slow", "dead-reckoning", out=out, trials=TRIALS, more=line))
        while driver.poll() is None and kills < KILLS:
            time.sleep(draw.uniform(0.1, 2.0))
            workers = psutil.Process(driver.pid).children() if driver.poll() is None else []
            if workers:
                kills += 1
                draw.choice(workers).kill()
        driver.communicate(timeout=400)
        # A job that was hit twice is a failed row; nothing else may differ.
        again = start(words("misfits:Slow", "dead-reckoning", out=out, trials=TRIALS, more=line))
        _, err = again.communicate(timeout=400)
        assert again.returncode == 0, err
        assert rows(out) == undisturbed


def test_workers_end_with_a_killed_driver(place: Path) -> None:
    driver = start(words("misfits:Hangs", trials=2, more=("--jobs", "2")))
    wait_for(lambda: len(psutil.Process(driver.pid).children()) == 2, driver)
    workers = psutil.Process(driver.pid).children()
    assert len(workers) == 2
    driver.kill()
    driver.communicate()
    gone, alive = psutil.wait_procs(workers, timeout=30)
    assert len(gone) == 2 and not alive


def test_dask_gives_the_same_rows_though_a_worker_is_killed(place: Path, undisturbed: list[dict[str, Any]]) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    names = ("misfits:Slow", "dead-reckoning", "misfits:Exits")
    made = tasks.plan(sweep.points(sweep.from_tables({"scenario": "tiny", "set": SET}), names), TRIALS, 0)
    plain = tasks.Plan(tuple(dataclasses.replace(t, jobs=t.jobs[:2]) for t in made.tasks), made.worlds, made.options)
    limits, draw, killed = Limits(60, 2**31), random.Random(7), 0
    with executors.executor("dask", 1 if KILLS == 1 else 2, limits) as local:
        assert isinstance(local, executors.Dask)

        def kill() -> None:
            nanny = draw.choice(list(local.client.cluster.workers.values()))
            with contextlib.suppress(ProcessLookupError, TypeError):
                os.kill(nanny.pid, signal.SIGKILL)

        def heard(*_: Any) -> None:
            # At a random moment after some row, the first included.
            nonlocal killed
            if killed < KILLS and (killed % 2 == 0 or draw.random() < 0.3):
                killed += 1
                threading.Timer(draw.uniform(0.0, 0.5), kill).start()

        while killed < KILLS:
            out = place / f"out{killed}"
            with writing(out, "test", {}) as store:
                sweeping.carry_out(plain, store, local, heard)
                # A job that was hit twice is a failed row; nothing else may differ.
                sweeping.carry_out(sweeping.pending(plain, store, True), store, local, lambda *_: None)
            assert rows(out) == undisturbed
        if KILLS > 1:
            _misfit_on_a_running_cluster(place, local, limits)


def _misfit_on_a_running_cluster(place: Path, local: executors.Dask, limits: Limits) -> None:
    names = ("misfits:Slow", "dead-reckoning", "misfits:Exits")
    few = tasks.plan(sweep.points(sweep.from_tables({"scenario": "tiny", "set": SET}), names), 1, 9)
    address = local.client.scheduler.address
    with executors.executor("dask", 2, limits, address) as running, writing(place / "out", "test", {}) as store:
        sweeping.carry_out(few, store, running, lambda *_: None)
    found = {row["estimator"]: row for row in rows("out")}
    assert [found[name]["status"] for name in names] == ["ok", "ok", "failed"]
    assert "exit status 7; alone it was lost again" in found["misfits:Exits"]["error"]


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr(executors, "CONNECT_S", 0.2)
    with (
        pytest.raises(InputError, match=r"no Dask scheduler answers there"),
        executors.executor("dask", 1, Limits(60, 2**31), "tcp://127.0.0.1:9"),
    ):
        raise AssertionError


def test_control_c_says_how_to_go_on(place: Path) -> None:
    driver = start(words("misfits:Slow", trials=500, more=("--jobs", "1")))
    wait_for(lambda: stored(place / "out") > 0, driver)
    driver.send_signal(signal.SIGINT)
    _, err = driver.communicate(timeout=60)
    assert driver.returncode == 130, err
    assert "Traceback" not in err and "are kept in out" in err and "cellslam sweep tiny" in err
    assert 0 < stored(place / "out") < 500


def test_second_driver_is_refused(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with writing(place / "out", "cellslam sweep the first", {}):
        assert main(words("dead-reckoning")) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and f"process {os.getpid()} on" in err and "cellslam sweep the first" in err


def test_workers_that_do_not_start_are_one_line(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    points = sweep.points(sweep.from_tables({"scenario": "tiny"}), ("dead-reckoning",))
    with Pool(2, Limits(60, 2**31)) as pool, pytest.raises(InputError, match="worker processes do not start"):
        list(pool.run(tasks.plan(points, 2, 0).tasks))


def test_dry_run_counts_estimates_and_writes_nothing(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    more = ("--dry-run", "--sweep", "radio.load=0.1,0.2", "--sweep", "estimator.fastslam.particles=5,6,7")
    assert main([*words("fastslam", "dead-reckoning", trials=10), *more]) == 0
    out = capfd.readouterr().out
    assert "6 points, 20 worlds, 80 rows\n" in out
    assert "one trial, timed now: world" in out and "fastslam" in out
    assert {path.name for path in place.iterdir()} <= {"misfits.py", "__pycache__"}


def test_progress_and_running_table(place: Path, capfd: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    from cellslam.benchmarks.sweeps import watch

    monkeypatch.setattr(watch, "LINE_EVERY_S", 0.0)
    monkeypatch.setattr(watch, "TABLE_EVERY_S", 0.0)
    line = [word for word in words("misfits:Good", "misfits:Raises", trials=1) if word != "--quiet"]
    assert main([*line, "--executor", "serial", "--sweep", "radio.load=0.1,0.2"]) == 1
    err = capfd.readouterr().err
    assert "4 of 4 rows" in err and "rows/s" in err and "2 failed" in err and "--retry-failed" in err
    assert main([*line, "--executor", "serial", "--sweep", "radio.load=0.3", "--live"]) == 1
    assert "radio.load=0.3, misfits:Good" in capfd.readouterr().err


SWEEP = ("sweep", "tiny", "--estimator", "dead-reckoning", "--out", "out")
WRONG = {
    "no out": (("sweep", "tiny"), "--out"),
    "key": ((*SWEEP, "--sweep", "radio.laod=1"), "unknown key 'radio.laod'"),
    "value": ((*SWEEP, "--sweep", "radio.load=0.5,7"), "radio.load = 7"),
    "form": ((*SWEEP, "--sweep", "radio.load"), "write KEY=VALUE"),
    "executor": ((*SWEEP, "--executor", "threads"), "'threads'"),
    "jobs": ((*SWEEP, "--jobs", "0"), "--jobs 0: must be at least 1"),
    "time": ((*SWEEP, "--time-limit", "0"), "--time-limit 0: must be above 0"),
    "memory": ((*SWEEP, "--memory-limit", "-1"), "--memory-limit -1"),
    "scheduler": ((*SWEEP, "--scheduler", "tcp://x:1"), "--scheduler is for --executor dask"),
    "trials": ((*SWEEP, "--trials", "0"), "trials = 0"),
    "folder": ((*SWEEP[:-1], "/dev/null/x"), "not a folder"),
    "both": ((*SWEEP, "--set", "radio.load=1", "--sweep", "radio.load=1"), "swept, and set"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_request_is_one_line_and_leaves_nothing(
    place: Path, capfd: pytest.CaptureFixture[str], kind: str
) -> None:
    line, expected = WRONG[kind]
    try:
        status = main(line)
    except SystemExit as end:
        status = int(str(end.code))
    out, err = capfd.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert expected in err
    assert {path.name for path in place.iterdir()} == {"misfits.py"}
