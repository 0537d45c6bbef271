"""Where the time of a command goes."""

from __future__ import annotations

import re
import time

import pytest
from numba.core import event

from cellslam.cli.time_spent import TimeSpent
from cellslam.sim.progress import silent
from tests.command_line import Run
from tests.short_drive import SHORT


def test_time_is_that_of_outer_tasks_and_compiling_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    spent, now = TimeSpent(), [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(event, "timer", lambda: now[0])
    spent._begin = 0.0
    progress = spent.of(silent)
    with progress("tracing rays", 1):
        now[0] += 1.0
        with progress("blocks", 1), event.trigger_event("numba:compile"), event.trigger_event("numba:compile"):
            now[0] += 4.0
    with progress("compiling fastslam, once per machine", 1):
        now[0] += 0.5  # another process does
        with event.trigger_event("numba:compile"):
            now[0] += 0.25
    with progress("tracing rays", 1):
        now[0] += 2.0
    now[0] += 0.5
    assert spent.in_words() == (
        "took 8.2 s: 4.8 for compiled code (made once, then loaded), 3.0 tracing rays, 0.5 other"
    )


@pytest.mark.slow
def test_a_run_says_where_its_time_went(cellslam: Run) -> None:
    done = cellslam("run", "tiny", *SHORT, "--estimator", "dead-reckoning")
    took, *parts = re.findall(r"[\d.]+(?= s:| [a-zA-Z])", re.search("took .*", done.err)[0])  # type: ignore[index]
    assert done.status == 0 and float(took) == pytest.approx(sum(map(float, parts)), abs=0.7)
    assert "figures" in done.err  # a world of this size takes less than what is named
