"""A scale of range, common to all links, as a state: observable by surveyed transmitters, and only where it may be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.recordings import Campaign
from cellslam.recordings.importing.campaign import RANGE_SCALE_STD, build
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.joint.bp_slam import BpSlam
from cellslam.slam.joint.ekf_slam import EkfSlam
from tests.slam.driving import driven

SCALE = 0.06
Toy = Callable[..., Recording]


def long_ranges(recording: Recording, range_scale_std: float) -> Recording:
    """The same drive with known clocks and surveyed sites, all of whose distances are 6 % too long."""
    truth, m = recording.truth, recording.measurements
    assert truth is not None
    offset = truth.clock_offsets_m[recording.links.site[m.link]]
    sites = replace(
        recording.sites, clock_offset_mean_m=truth.clock_offsets_m, clock_offset_std_m=np.zeros(2),
        position_m=truth.site_positions_m,
    )  # fmt: skip
    measurements = replace(m, distance_m=(1.0 + SCALE) * (m.distance_m - offset) + offset)
    return replace(recording, sites=sites, measurements=measurements, range_scale_std=range_scale_std)


@pytest.mark.parametrize("estimator", [EkfSlam, FastSlam, BpSlam])
def test_surveyed_transmitters_make_the_scale_observable(estimator: Any, toy_recording: Toy) -> None:
    recording = long_ranges(toy_recording(80), 0.04)
    one = estimator()
    last = driven(one, recording)[-1]
    mixture = one._joint.collapsed()
    at = mixture.core.range_scale
    k, deviation = mixture.likeliest.x[at], np.sqrt(mixture.likeliest.p[at, at])
    assert deviation < 0.01 and abs(k - SCALE) < 4.0 * deviation
    e = last.pose[:2] - recording.truth.poses[-1, :2]
    assert e @ np.linalg.solve(last.covariance[:2, :2], e) < 16.0


def test_where_there_is_none_there_is_no_state(toy_recording: Toy) -> None:
    one = EkfSlam()
    driven(one, long_ranges(toy_recording(), 0.0), count=1)
    assert one._core.range_scale == -1


def test_a_campaign_has_a_scale_unless_it_has_no_distances(tmp_path: Path) -> None:
    given = {"odometry": None, "start_pose": (0.0,) * 6, "plane": True}
    ranges = build(Campaign([0.0, 1.0], {"distance_m": [5.0, 6.0]}, **given))
    assert ranges.range_scale_std == RANGE_SCALE_STD
    assert build(Campaign([0.0, 1.0], {"azimuth_rad": [0.1, 0.2]}, **given)).range_scale_std == 0.0
    replace(ranges, range_scale_std=0.03).save(tmp_path / "ranges.h5")
    assert Recording.load(tmp_path / "ranges.h5").range_scale_std == 0.03
    with pytest.raises(InputError, match="range_scale_std, row 0: is not a standard deviation"):
        replace(ranges, range_scale_std=-0.1)
