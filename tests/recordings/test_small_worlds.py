"""Where the drive is small, clock offsets are tried finely at the start: what is taken for known must be so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings import build
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.recordings.fitting.fit_noise import unmodelled
from cellslam.scenarios.recording_origin import Origin
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from tests.recordings.mistaken_worlds import beacons, places
from tools.foreign_drives import world


def test_sources_are_taken_for_as_far_as_the_drive_extends() -> None:
    hall, usual = build(places(7)), EkfSlamOptions()
    assert hall.reference is not None
    extent = float(np.hypot(*np.ptp(hall.reference.position_m[:, :2], axis=0)))
    own = EkfSlamOptions(**unmodelled(hall))
    assert own.typical_range_m == pytest.approx(extent, rel=0.2) and own.component_std_m < 0.12 * extent
    blind = replace(hall, odometry=np.full_like(hall.odometry, np.nan))
    assert unmodelled(blind)["typical_range_m"] == unmodelled(build(beacons(1)))["typical_range_m"] == 200.0
    assert usual.component_std_m == 20.0


@pytest.mark.slow
def test_a_clock_is_not_taken_for_known_after_the_first_path() -> None:
    """A square of 60 m, one surveyed site whose clock is unknown by 30 m, 54 features. With components of 20 m a
    reflection is taken for the line of sight, and the error is twice as large."""
    recording = build(world(166).campaign)
    (request,) = assumed(recording, Origin.of(recording), ("ekf-slam",), {}, fit=False).requests
    found = score(recording, estimate(recording, request, np.random.default_rng(0)), None)
    assert found["position_rmse_m"] < 2.0
