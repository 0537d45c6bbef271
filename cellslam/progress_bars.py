"""Progress on stderr: bars on a terminal, in a notebook a line that changes, elsewhere lines for what takes long."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cellslam.sim.progress import Progress, silent

NOTICED_S = 5.0
CHANGED_S = 0.5  # how often the line in a notebook changes


@contextmanager
def shown(progress: Progress | bool) -> Iterator[Progress]:
    """Open what a function of Python was asked to report to: the usual display, none, or one of the caller's own."""
    if isinstance(progress, bool):
        with bars(quiet=not progress) as display:
            yield display
    else:
        yield progress


@contextmanager
def bars(quiet: bool) -> Iterator[Progress]:
    """Open the display for all tasks of a command; nothing is shown if `quiet`."""
    if quiet:
        yield silent
    elif sys.stderr.isatty():
        with _on_terminal() as progress:
            yield progress
    elif "ipykernel" in sys.modules:
        yield _in_notebook
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
    begin = time.monotonic()
    with _repeated(NOTICED_S, lambda done: sys.stderr.write(f"{description}: {done} of {total} ...\n"), 1) as advance:
        yield advance
    if time.monotonic() - begin > NOTICED_S:
        sys.stderr.write(f"{description}: {time.monotonic() - begin:.1f} s\n")


@contextmanager
def _in_notebook(description: str, total: int) -> Iterator[Callable[[int], None]]:
    begin, longest = time.monotonic(), [0]

    def rewrite(done: int) -> None:
        text = f"{description}: {done} of {total}, {time.monotonic() - begin:.0f} s"
        longest[0] = max(longest[0], len(text))
        sys.stderr.write(f"\r{text:{longest[0]}}")

    with _repeated(CHANGED_S, rewrite) as advance:
        yield advance
    if longest[0]:
        sys.stderr.write(f"\r{'':{longest[0]}}\r")


@contextmanager
def _repeated(
    every_s: float, tell: Callable[[int], object], times: int | None = None
) -> Iterator[Callable[[int], None]]:
    """Call `tell` with the number of steps done, again and again (None: to the end) while the body works."""
    done = [0]

    def advance(steps: int) -> None:
        done[0] += steps

    def watch() -> None:
        shown = 0
        while shown != times and not over.wait(every_s):
            tell(done[0])
            shown += 1

    over = threading.Event()
    watching = threading.Thread(target=watch, daemon=True)
    try:
        watching.start()  # Ctrl-C may come here, too
        yield advance
    finally:
        over.set()
        if watching.is_alive():
            watching.join()  # a line that comes late would stand in the output of something else
