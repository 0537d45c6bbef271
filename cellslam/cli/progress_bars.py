"""Progress on stderr: bars on a terminal, elsewhere a line for whatever takes longer than five seconds."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cellslam.sim.progress import Progress, silent

NOTICED_S = 5.0


@contextmanager
def bars(quiet: bool) -> Iterator[Progress]:
    """Open the display for all tasks of a command; nothing is shown if `quiet`."""
    if quiet:
        yield silent
    elif sys.stderr.isatty():
        with _on_terminal() as progress:
            yield progress
    else:
        yield _in_lines


@contextmanager
def _on_terminal() -> Iterator[Progress]:
    from rich import progress as rich_progress
    from rich.console import Console

    columns = (
        rich_progress.SpinnerColumn(),
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.MofNCompleteColumn(),
        rich_progress.TimeElapsedColumn(),
    )
    with rich_progress.Progress(*columns, console=Console(stderr=True), transient=True) as display:

        @contextmanager
        def task(description: str, total: int) -> Iterator[Callable[[int], None]]:
            bar = display.add_task(description, total=total)
            try:
                yield lambda steps: display.advance(bar, steps)
            finally:
                display.remove_task(bar)

        yield task


@contextmanager
def _in_lines(description: str, total: int) -> Iterator[Callable[[int], None]]:
    begin, done = time.monotonic(), [0]

    def advance(steps: int) -> None:
        done[0] += steps

    def notice() -> None:
        if not over.wait(NOTICED_S):
            sys.stderr.write(f"{description}: {done[0]} of {total} ...\n")

    over = threading.Event()
    waiting = threading.Thread(target=notice, daemon=True)
    try:
        waiting.start()  # Ctrl-C may come here, too
        yield advance
    finally:
        over.set()
        if waiting.is_alive():
            waiting.join()  # a line that comes late would stand in the output of something else
        if time.monotonic() - begin > NOTICED_S:
            sys.stderr.write(f"{description}: {time.monotonic() - begin:.1f} s\n")
