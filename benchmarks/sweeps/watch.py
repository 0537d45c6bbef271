"""What is shown of a sweep while it runs, here or elsewhere: how much is done, how fast, what is left, why rows failed,
a running table."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from cellslam.sim.errors import one_line

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from cellslam.benchmarks.sweeps.sweeping import OnResult
    from cellslam.benchmarks.sweeps.tasks import Job, Task

LINE_EVERY_S = 10.0
TABLE_EVERY_S = 3.0
MOST_LINES, MOST_REASONS = 30, 5
PIPE_WIDTH = 100
METRIC = "position_rmse_m"


@dataclass
class Tally:
    """What was done so far. `names`: what the running table calls a job, by (world, estimator, options); `elsewhere`:
    rows a second of other processes, where these do them; `errors`: how many rows failed, by estimator and reason."""

    total: int
    names: Mapping[tuple[str, str, str], str] = field(default_factory=dict)
    elsewhere: float | None = None
    begin: float = field(default_factory=time.monotonic)
    done: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    groups: dict[str, list[float | None]] = field(default_factory=dict)

    def hear(self, task: Task, job: Job, row: Mapping[str, Any]) -> None:
        """Count a row of a job."""
        self.count(self.names.get((task.world, job.estimator, job.options), job.estimator), row)

    def count(self, name: str, row: Mapping[Any, Any]) -> None:
        """Count a row that is called `name`."""
        self.done += 1
        if row["status"] == "failed":
            self.errors[f"{row['estimator']}: {row['error']}"] += 1
        self.groups.setdefault(name, []).append(row[METRIC])

    @property
    def seconds(self) -> float:
        """The time since it began."""
        return max(time.monotonic() - self.begin, 1e-9)

    def line(self) -> str:
        """Return the state in one line."""
        rate = self.done / self.seconds if self.elsewhere is None else self.elsewhere
        left = f"{clock((self.total - self.done) / rate)} left" if rate else "no new row yet"
        failed = f", {self.errors.total()} failed" if self.errors else ""
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
        below = [f"and {len(self.groups) - MOST_LINES} more"] if len(self.groups) > MOST_LINES else []
        below += [f"{count} failed: {one_line(error, 200)}" for error, count in self.errors.most_common(MOST_REASONS)]
        table.caption, table.caption_justify = escape("\n".join(below)) or None, "left"
        return table


def tally_of(folder: Path) -> Tally:
    """Return what is done of the last sweep into `folder`, by whatever processes. Raises InputError."""
    from cellslam.benchmarks.sweeps.rows import results, varying_keys
    from cellslam.benchmarks.sweeps.shards import noted_shares
    from cellslam.benchmarks.sweeps.store import rows_per_s

    varied = varying_keys(folder)
    frame = results(folder, ["key", "estimator", "status", "error", METRIC, *varied])
    asked = {key for keys in noted_shares(folder).values() for key in keys} or {*frame["key"]}
    tally = Tally(len(asked), elsewhere=rows_per_s(folder))
    for row in frame[frame["key"].isin(asked)].astype(object).where(frame.notna(), None).to_dict("records"):
        settings = {key: row[key] for key in varied if row[key] is not None}
        tally.count(label(settings, row["estimator"]), row)
    return tally


def label(settings: Mapping[str, Any], estimator: str) -> str:
    """Return what the running table calls an estimator with these settings; those of other estimators are left out."""
    own = (
        f"{key}={f'{value:.6g}' if isinstance(value, float) else value}"
        for key, value in settings.items()
        if not key.startswith("estimator.") or key.startswith(f"estimator.{estimator}.")
    )
    return ", ".join([*own, estimator])


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
