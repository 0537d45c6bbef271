"""Map builders on recordings that nobody modelled, with what is learnt from them alone."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.recordings import build


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The study beside this file, which `python` runs, too."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return importlib.import_module("study_worlds")


def test_few_wide_measurements_beat_odometry(study: Any) -> None:
    """45 places, angles of three degrees: in nearly every drive, and by 0.6 on the whole."""
    found = [study.errors(build(study.surveyed(seed)), ("ekf-slam",), seed) for seed in range(2000, 2008)]
    alone, own = (np.array([row[name] for row in found]) for name in ("dead-reckoning", "ekf-slam"))
    assert (own < alone).sum() >= 7
    assert np.sqrt(np.mean(own**2)) < 0.6 * np.sqrt(np.mean(alone**2))


@pytest.mark.parametrize("seed", [1001, 2001, 2004])
def test_ranges_to_polled_beacons_beat_odometry(study: Any, seed: int) -> None:
    found = study.errors(build(study.WORLDS["beacons"](seed)), ("ekf-slam",), seed)
    assert found["ekf-slam"] < 0.5 * found["dead-reckoning"]
