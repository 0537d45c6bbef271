"""Lines of progress, where stderr is no terminal."""

from __future__ import annotations

import threading
import time

import pytest

from cellslam.cli import progress_bars


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_bars, "NOTICED_S", 0.1)


def test_what_takes_long_is_said_once_and_when_it_is_over(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars.bars(False) as progress, progress("driving", 3) as advance:
        advance(1)
        time.sleep(0.3)
    first, last = capsys.readouterr().err.splitlines()
    assert first == "driving: 1 of 3 ..." and last.startswith("driving: 0.") and last.endswith(" s")


def test_no_line_comes_after_an_interrupt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C may come while the thread that waits for the line begins."""
    real = threading.Thread.start

    def start(thread: threading.Thread) -> None:
        real(thread)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", start)
    with pytest.raises(KeyboardInterrupt), progress_bars.bars(False) as progress, progress("driving", 3):
        pass
    time.sleep(0.3)
    assert capsys.readouterr().err == ""
