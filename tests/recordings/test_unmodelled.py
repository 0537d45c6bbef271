"""Map builders on recordings that nobody modelled, with what is learnt from them alone."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.scores.alignment import aligned
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.recordings import build
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.recording import Recording

CHANCE = 1.2  # of two estimates that are about as good
DRIVES, LONG = 5, ("trees by bad odometry", "cellular")  # of long ones one


@pytest.fixture
def studies(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Loads the studies beside this file, which `python` runs, too."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    return importlib.import_module


# By which the data sheet is wrong; trees alone are left out, as they are the same with worse odometry.
FACTORS = {"hall": 5.0, "hall with an arm": 0.2, "places": 5.0, "beacons": 0.2, "trees by bad odometry": 0.2,
           "cellular": 5.0, "surveyed": 0.2}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", FACTORS)
def test_what_is_learnt_does_no_harm(studies: Any, name: str) -> None:
    """Campaigns of nearly all kinds by data sheets that are wrong by a factor of five, as they are and fitted; of one
    drive alone, either may have the smaller error by chance."""
    kinds, factor = {**studies("study_worlds").WORLDS, "surveyed": studies("study_worlds").surveyed}, FACTORS[name]
    squares = np.zeros(2)
    for drive in range(1 if name in LONG else DRIVES):
        campaign = kinds[name](3000 + list(kinds).index(name) + 100 * drive)
        recording = studies("study_sheets").mistold(build(campaign), "odometry", factor, ("ekf-slam",))
        squares += [error(recording, fit) ** 2 for fit in (False, True)]
    as_assumed, fitted = np.sqrt(squares)
    assert fitted < CHANCE * as_assumed, (
        f"{name}, assumed {factor}: {as_assumed:.2f} m as assumed, {fitted:.2f} m fitted"
    )


def error(recording: Recording, fit: bool) -> float:
    """Return the RMSE (m) of ekf-slam by a recording's own data sheet, or by what is learnt.

    Laid onto the reference: the heading at the start, which some campaigns do not tell, is nobody's merit.
    """
    given = assumed(recording, Origin.of(recording), ("ekf-slam",), {}, fit)
    (request,) = given.requests
    warm_up(request)
    drive = replace(recording, odometry_model=given.odometry_model)
    result = aligned(recording, estimate(drive, request, np.random.default_rng(0)))
    return float(score(recording, result, None)["position_rmse_m"])
