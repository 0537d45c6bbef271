"""Drivers and workers that are killed: what is resumed ends as if nothing had been."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from cellslam.benchmarks.sweeps import executors, sweeping, tasks
from cellslam.benchmarks.sweeps.store import TRAJECTORIES, writing
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.cli.main import main
from cellslam.scenarios import sweep_points as sweep
from tests.benchmarks.sweeps.short_sweeps import PLUGIN, rows, start, stored, wait_for, words
from tests.short_drive import SET

# How often driver and workers are killed; the full test: CELLSLAM_KILLS=20 pytest tests/benchmarks/sweeps/test_kills.py
KILLS = int(os.environ.get("CELLSLAM_KILLS", "1"))
TRIALS = 3 + 2 * KILLS


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


@pytest.mark.slow
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


@pytest.mark.skipif(KILLS == 1, reason="a long test: CELLSLAM_KILLS=20 pytest tests/benchmarks/sweeps/test_kills.py")
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


@pytest.mark.slow
def test_workers_end_with_a_killed_driver(place: Path) -> None:
    driver = start(words("misfits:Hangs", trials=2, more=("--jobs", "2")))
    wait_for(lambda: len(psutil.Process(driver.pid).children()) == 2, driver)
    workers = psutil.Process(driver.pid).children()
    assert len(workers) == 2
    driver.kill()
    driver.communicate()
    gone, alive = psutil.wait_procs(workers, timeout=30)
    assert len(gone) == 2 and not alive


@pytest.mark.slow
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
