"""What is assumed of a recording that nobody modelled, before anything is learnt."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings import build
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.recordings.fitting.fit_noise import UNKNOWN, unmodelled
from cellslam.scenarios.recording_origin import Origin
from tests.recordings.mistaken_worlds import places
from tools.foreign_drives import world


def test_stated_deviations_are_assumed() -> None:
    recording = build(places(7))
    stated = np.tile([np.nan, 0.4, 0.5, 3.0], len(recording.measurements.snapshot))[: len(recording.measurements)]
    known = unmodelled(replace(recording, measurements=replace(recording.measurements, distance_std_m=stated)))
    assert known["noise_floor_m"] == pytest.approx(0.5) and known["diffuse_m"] == pytest.approx(0.15)
    assert known["noise_floor_azimuth_deg"] == UNKNOWN["noise_floor_azimuth_deg"]


def test_every_map_builder_takes_the_defaults_that_it_has() -> None:
    recording = build(places(7))
    requests = assumed(recording, Origin.of(recording), ("fastslam", "phd-slam"), {}, fit=False).requests
    fastslam, phd_slam = (r.options.model_dump() for r in requests if r.options is not None)
    assert fastslam["slip_probability"] == UNKNOWN["slip_probability"] and "slip_probability" not in phd_slam
    assert fastslam["noise_floor_m"] == phd_slam["noise_floor_m"] == UNKNOWN["noise_floor_m"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf-slam", "fastslam"])
def test_a_slip_does_not_cost_the_map(name: str) -> None:
    """At 8 m/s, with two sites alone, wheels slip for two seconds in a turn: heading is off by twenty deviations."""
    recording = build(world(102).campaign)

    def found(given: dict[str, Any]) -> dict[str, Any]:
        (request,) = assumed(recording, Origin.of(recording), (name,), given, fit=False).requests
        return score(recording, estimate(recording, request, np.random.default_rng(0)), None)

    never, now = found({f"estimator.{name}.slip_probability": 0.0}), found({})
    assert now["position_rmse_m"] < 0.15 * never["position_rmse_m"]
    assert 1.0 < now["nees_mean"] < 5.0 < never["nees_mean"]
