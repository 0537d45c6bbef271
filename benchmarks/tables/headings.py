"""What stands above the columns of tables that are read away from the command line: reports, papers."""

from __future__ import annotations

import re

from cellslam.benchmarks.scores.metrics import METRIC

_KEY = re.compile(rf"\b({'|'.join(METRIC)})\b")
_CLASS = re.compile(r"[\w.]+:(?=\w)")


def in_words(text: str) -> str:
    """Return a text with headings in place of metrics, and classes without the modules that they are in."""
    return _CLASS.sub("", _KEY.sub(lambda found: METRIC[found[0]].titled, text))
