"""The one table of plausible ranges: what it refuses, what `inspect` remarks, and that the page says the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellslam.recordings.inspection.suspicions import suspicions
from cellslam.sim.errors import InputError
from cellslam.sim.plausible import RANGES
from cellslam.sim.recording import Recording
from cellslam.sim.recording.columns import COLUMNS
from cellslam.sim.recording.contract import TIMES, values_of
from cellslam.slam.conformance.subject import tiny_drive

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "recording-files.md"


def changed(recording: Recording, path: str, value: float, row: int = 3) -> Recording:
    """Return a recording with one value changed; checked."""
    table, _, name = path.rpartition("/")
    parts = table.split("/") if table else []
    holders = [recording]
    for part in parts:
        holders.append(getattr(holders[-1], part))
    held = np.array(getattr(holders[-1], name), ndmin=1)
    held[min(row, len(held) - 1)] = value
    new = replace(holders[-1], **{name: held.reshape(np.shape(getattr(holders[-1], name)))})
    for part, holder in zip(reversed(parts), reversed(holders[:-1]), strict=True):
        new = replace(holder, **{part: new})
    return new


MEASURED = [c.path for c in COLUMNS if c.kind == "float" and c.path in values_of(tiny_drive()) and c.path not in TIMES]


@pytest.mark.parametrize("path", MEASURED)
@pytest.mark.parametrize("value", [1e12, np.inf, -1e300])
def test_what_cannot_be_is_refused(path: str, value: float) -> None:
    with pytest.raises(InputError, match=path.replace("/", ".")):
        changed(tiny_drive(), path, value)


@pytest.mark.parametrize("path", [path for path in MEASURED if path.startswith("truth/") and "std" not in path])
def test_truth_is_known(path: str) -> None:
    if "merging" not in path:
        with pytest.raises(InputError, match="is not finite"):
            changed(tiny_drive(), path, np.nan)


@pytest.mark.parametrize(
    ("later_s", "words"), [(1e7, "step to row 9: 1e\\+07 s cannot be"), (1e-300, "cannot be|is not after")]
)
def test_steps_of_time(later_s: float, words: str) -> None:
    drive = tiny_drive()
    time_s = np.concatenate([drive.time_s[:9], drive.time_s[8] + later_s + np.arange(len(drive.time_s) - 9)])
    with pytest.raises(InputError, match=words):
        replace(drive, time_s=time_s)
    with pytest.raises(InputError, match=r"time_s, step to row 1: 1e-300 s cannot be"):
        replace(drive, time_s=1e-300 * np.arange(len(drive.time_s)))


@pytest.mark.parametrize(
    ("path", "value", "kind"),
    [("measurements/distance_m", 1e7, "unusual"), ("start_pose", 3e7, "unusual"),
     ("measurements/snr_db", 250.0, "unusual"), ("measurements/distance_m", -5000.0, "negative-distances")],
)  # fmt: skip
def test_what_is_unusual_is_remarked(
    path: str, value: float, kind: str, toy_recording: Callable[..., Recording]
) -> None:
    assert not suspicions(toy_recording())
    found = suspicions(changed(toy_recording(), path, value, row=0))
    assert [one.kind for one in found] == [kind]


def test_the_page_has_the_table() -> None:
    page = PAGE.read_text("utf-8")
    for quantity, span in RANGES.items():
        usual, possible = (f"{least:g} to {most:g}" for least, most in (span.usual, span.possible))
        assert f"| {quantity} | {span.unit} | {usual} | {possible} | {span.why} |" in page
