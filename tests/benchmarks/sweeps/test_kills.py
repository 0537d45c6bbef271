"""Drivers and workers that are killed: what is resumed ends as if nothing had been."""

from __future__ import annotations

import contextlib
import os
import random
import signal
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
from tests.benchmarks.sweeps.short_sweeps import rows, start, stored, wait_for, words
from tests.benchmarks.trials.hostile_estimators import MISFITS
from tests.short_drive import SET

TRIALS = 5


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "misfits.py").write_text(MISFITS)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", list(sys.path))
        tasks._request_of.cache_clear()
        assert main(words("misfits:Slow", "dead-reckoning", trials=TRIALS, more=("--executor", "serial"))) == 0
    return rows(folder / "out")


@pytest.mark.slow
def test_kills_lose_at_most_what_was_in_flight(place: Path, undisturbed: list[dict[str, Any]]) -> None:
    """A worker, then the driver, are killed; every row that was there is still there, and what is resumed ends
    undisturbed."""
    line = words("misfits:Slow", "dead-reckoning", trials=TRIALS, more=("--jobs", "2", "--retry-failed"))
    draw, out, driver = random.Random(5), place / "out", start(line)
    wait_for(lambda: stored(out) > 0, driver)
    draw.choice(psutil.Process(driver.pid).children()).kill()
    time.sleep(draw.uniform(0.0, 0.5))
    seen = stored(out)
    assert driver.poll() is None and seen < len(undisturbed)
    driver.kill()
    driver.communicate()
    kept = rows(out)
    assert len(kept) >= seen and all(row in undisturbed or "SIGKILL" in row["error"] for row in kept)
    last = start(line)
    _, err = last.communicate(timeout=400)
    assert last.returncode == 0, err
    assert rows(out) == undisturbed
    assert len(list(Path(out, TRAJECTORIES).rglob("*.npz"))) == len(undisturbed)


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
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    points = sweep.points(sweep.from_tables({"scenario": "tiny", "set": SET}), ("misfits:Slow", "dead-reckoning"))
    made, killers = tasks.plan(points, TRIALS, 0), list[threading.Timer]()
    with executors.executor("dask", 1, Limits(60, 2**31)) as local, writing(place / "out", "test", {}) as store:

        def kill() -> None:
            (nanny,) = distributed.default_client().cluster.workers.values()
            with contextlib.suppress(ProcessLookupError, TypeError):
                os.kill(nanny.pid, signal.SIGKILL)

        def kill_soon(*_: Any) -> None:
            if not killers:
                killers.append(threading.Timer(0.2, kill))
                killers[0].start()

        sweeping.carry_out(made, store, local, kill_soon)
        # A job that was hit twice is a failed row; nothing else may differ.
        sweeping.carry_out(sweeping.pending(made, store.folder, True), store, local, lambda *_: None)
    assert killers and rows(place / "out") == undisturbed
