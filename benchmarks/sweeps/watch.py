"""What a sweep shows on stderr while it runs: how much is done, how fast, what is left, failures, a running table."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from cellslam.benchmarks.sweeps.sweeping import OnResult
    from cellslam.benchmarks.sweeps.tasks import Job, Task

LINE_EVERY_S = 10.0
TABLE_EVERY_S = 3.0
MOST_LINES = 30
PIPE_WIDTH = 100
METRIC = "position_rmse_m"


@dataclass
class Tally:
    """What was done so far. `names`: what the running table calls a job, by (world, estimator, options)."""

    total: int
    names: Mapping[tuple[str, str, str], str] = field(default_factory=dict)
    begin: float = field(default_factory=time.monotonic)
    done: int = 0
    failed: int = 0
    first_error: str = ""
    groups: dict[str, list[float | None]] = field(default_factory=dict)

    def hear(self, task: Task, job: Job, row: Mapping[str, Any]) -> None:
        """Count a row."""
        self.done += 1
        if row["status"] == "failed":
            self.failed += 1
            self.first_error = self.first_error or f"the first: {row['estimator']}: {row['error']}"
        name = self.names.get((task.world, job.estimator, job.options), job.estimator)
        self.groups.setdefault(name, []).append(row[METRIC])

    @property
    def seconds(self) -> float:
        """The time since it began."""
        return max(time.monotonic() - self.begin, 1e-9)

    def line(self) -> str:
        """Return the state in one line."""
        rate = self.done / self.seconds
        left = f"{clock((self.total - self.done) / rate)} left" if self.done else "no row yet"
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.done} of {self.total} rows, {rate:.2f} rows/s, {left}{failed}"

    def table(self) -> Table:
        """Return the running table: medians so far."""
        from rich import box
        from rich.markup import escape
        from rich.table import Table

        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=escape(self.line()), title_justify="left")
        table.add_column("so far", overflow="fold")
        for heading in ("median RMSE (m)", "rows", "failed"):
            table.add_column(heading, justify="right")
        for name, every in sorted(self.groups.items())[:MOST_LINES]:
            values = [value for value in every if value is not None]
            middle = f"{median(values):.2f}" if values else "-"
            table.add_row(escape(name), middle, str(len(every)), str(len(every) - len(values)))
        if len(self.groups) > MOST_LINES:
            table.caption = f"and {len(self.groups) - MOST_LINES} more"
        return table


@contextmanager
def watching(tally: Tally, quiet: bool, live: bool) -> Iterator[OnResult]:
    """Show a tally on stderr while rows come in; the value is called with each row."""
    if quiet:
        yield tally.hear
        return
    from rich.console import Console
    from rich.live import Live

    def shown() -> RenderableType:
        return tally.table() if live else tally.line()

    if sys.stderr.isatty():
        with Live(console=Console(stderr=True), get_renderable=shown, refresh_per_second=1, transient=True):
            yield tally.hear
        return
    console, last = Console(stderr=True, width=PIPE_WIDTH), time.monotonic()

    def hear(task: Task, job: Job, row: Mapping[str, Any]) -> None:
        nonlocal last
        tally.hear(task, job, row)
        if time.monotonic() - last >= (TABLE_EVERY_S if live else LINE_EVERY_S):
            last = time.monotonic()
            console.print(shown(), markup=False, highlight=False)

    yield hear


def clock(seconds: float) -> str:
    """Return a duration in words: 45 s, 12 min, 3.5 h."""
    if seconds < 90:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
