"""Progress where stderr is no terminal: lines, or in a notebook one line that changes."""

from __future__ import annotations

import sys
import threading
import time
from types import ModuleType

import pytest

from cellslam import progress_bars
from cellslam.sim.progress import silent


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_bars, "NOTICED_S", 0.1)


def test_what_takes_long_is_said_once_and_when_it_is_over(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars.bars(False) as progress, progress("driving", 3) as advance:
        advance(1)
        time.sleep(0.3)
    first, last = capsys.readouterr().err.splitlines()
    assert first == "driving: 1 of 3 ..." and last.startswith("driving: 0.") and last.endswith(" s")


def test_in_a_notebook_one_line_counts_and_then_goes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    monkeypatch.setattr(progress_bars, "CHANGED_S", 0.05)
    with progress_bars.shown(True) as progress, progress("driving", 3) as advance:
        advance(2)
        time.sleep(0.2)
    text = capsys.readouterr().err
    assert "\n" not in text and "\rdriving: 2 of 3, 0 s" in text
    assert text.rsplit("\r", 2)[1].isspace() and text.endswith("\r")


def test_false_shows_nothing_and_ones_own_is_asked(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars.shown(False) as progress, progress("driving", 3):
        time.sleep(0.3)
    assert capsys.readouterr().err == ""
    with progress_bars.shown(silent) as progress:
        assert progress is silent


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
