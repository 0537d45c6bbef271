"""Words for what goes wrong in a trial: one line for its row, and the traceback beside it."""

from __future__ import annotations

import traceback

from cellslam.benchmarks.trials.answers import BadAnswerError
from cellslam.sim.errors import InputError, one_line
from cellslam.slam.registry import own_traceback

MOST_NOTES = 3
MOST_DETAILS = 20_000


class ExternalError(Exception):
    """An estimator failed in its own process: the reason in one line, and what it printed."""

    def __init__(self, reason: str, details: str = "") -> None:
        super().__init__(reason)
        self.details = details


class LostError(ExternalError):
    """The process of an estimator died, or was killed since it gave no answer in time."""


def explained(error: BaseException) -> str:
    """Return an error as one line: what, in which snapshot, and the estimator's own traceback."""
    if isinstance(error, ExternalError):
        return str(error)
    text = one_line(error)
    if isinstance(error, InputError):
        return text
    known = isinstance(error, BadAnswerError)
    line = text if known else f"{type(error).__name__}: {text}".removesuffix(": ")
    notes = getattr(error, "__notes__", None)
    added = "".join(f", {one_line(note)}" for note in notes[-MOST_NOTES:]) if isinstance(notes, list) else ""
    return line + added + ("" if known else own_traceback(error))


def details(error: BaseException) -> str:
    """Return the traceback of an error as text that any file holds; of a long one the beginning and the end."""
    whole = error.details if isinstance(error, ExternalError) else "".join(traceback.format_exception(error))
    text = whole.encode("utf-8", "backslashreplace").decode()
    half = MOST_DETAILS // 2
    return text if len(text) <= MOST_DETAILS else f"{text[:half]}\n...\n{text[-half:]}"
