"""Sweeps of short drives, by estimators that misbehave: what tests of sweeping share."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cellslam.benchmarks.scores.metrics import COST_KEYS, ROW_KEYS
from cellslam.benchmarks.sweeps.store import DATABASE
from tests.short_drive import SHORT

COMMAND = Path(sys.executable).parent / "cellslam"


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
