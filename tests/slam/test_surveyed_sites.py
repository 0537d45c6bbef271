"""Transmitters that were surveyed: every estimator believes a survey as far as its deviation says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.api import setup_of
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.joint.bp_slam import BpSlam
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.snapshot.birth_kernel import _displaced
from cellslam.slam.joint.state.layout import HITS, LAST, SURVEYED, block_of, one_of
from cellslam.slam.joint.wall_slam import WallSlam
from cellslam.slam.oracles import KnownAssociation
from tests.slam.driving import driven

ERROR_M = np.array([3.0, -2.0, 2.0])
Toy = Callable[..., Recording]


def surveyed(recording: Recording, error_m: Any, std_m: float) -> Recording:
    """The same drive with known clocks, and a survey of site A alone that errs by so much."""
    truth = recording.truth
    assert truth is not None
    place = np.where([[True], [False]], truth.site_positions_m + error_m, np.nan)
    sites = replace(
        recording.sites, clock_offset_mean_m=truth.clock_offsets_m, clock_offset_std_m=np.zeros(2), position_m=place,
        position_std_m=np.full((2, 3), std_m),
    )  # fmt: skip
    return replace(recording, sites=sites)


@pytest.mark.parametrize("estimator", [EkfSlam, FastSlam, WallSlam, BpSlam])
def test_a_survey_is_corrected_by_measurements_as_far_as_it_may_err(estimator: Any, toy_recording: Toy) -> None:
    recording = toy_recording(80)
    for std_m, nearer in ((3.0, True), (0.0, False)):
        vts = driven(estimator(), surveyed(recording, ERROR_M, std_m))[-1].vts
        assert vts is not None
        (row,) = np.flatnonzero(vts.id == 0)  # of the first link's transmitter
        off = np.linalg.norm(vts.position_m[row] - recording.truth.site_positions_m[0])
        if nearer:
            assert off < 0.6 * np.linalg.norm(ERROR_M)
            assert 0.1 < np.sqrt(np.trace(vts.covariance[row])) < 0.8 * std_m * np.sqrt(3.0)
        else:
            assert off == pytest.approx(np.linalg.norm(ERROR_M), abs=0.02)
            assert np.trace(vts.covariance[row]) < 1e-5


@pytest.mark.parametrize(
    ("error_m", "std_m", "named"), [(0.0, 0.1, False), (3.0, 3.0, False), (1.0, 0.1, True), (3.0, 0.1, True)]
)
def test_a_survey_that_measurements_contradict_is_named(
    error_m: float, std_m: float, named: bool, toy_recording: Toy
) -> None:
    one = EkfSlam()
    driven(one, surveyed(toy_recording(80), error_m * np.array([1.0, -0.6, 0.6]), std_m))
    assert any("the survey of site A" in line for line in one.remarks()) == named


def test_setup_has_the_links_of_surveyed_sites(toy_recording: Toy) -> None:
    link, position_m, std_m = setup_of(surveyed(toy_recording(), 0.0, 2.0)).surveyed
    assert link.tolist() == [0, 1] and std_m.tolist() == [[2.0] * 3] * 2
    np.testing.assert_array_equal(position_m, [[80.0, 10.0, 30.0]] * 2)
    assert len(setup_of(toy_recording()).surveyed[0]) == 0


def test_the_error_of_a_survey_is_that_of_all_links_of_the_site(toy_recording: Toy) -> None:
    estimator = EkfSlam(EkfSlam.Options(sharing="none"))
    estimator.start(setup_of(surveyed(toy_recording(), 0.0, 2.0)), np.random.default_rng(0))
    mixture = estimator._joint
    assert mixture is not None
    one, other = mixture.vts(0, 1)
    np.testing.assert_allclose(one[5:14].reshape(3, 3), 4.0 * np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(one[2:], other[2:])
    first = mixture.core.size
    P = mixture.likeliest.p[first : first + 6, first : first + 6]
    np.testing.assert_allclose(P[:3, 3:], P[:3, :3], rtol=1e-12)  # one error: correlated wholly


def test_what_was_surveyed_makes_room_for_nothing(toy_recording: Toy) -> None:
    estimator = EkfSlam()
    estimator.start(setup_of(surveyed(toy_recording(), 0.0, 2.0)), np.random.default_rng(0))
    assert estimator._joint is not None
    f, b = one_of(estimator._joint.arrays, 0), block_of(estimator._joint.blocks, 0)
    f.count[0] = 2
    f.vts.slots[:2, LAST], f.vts.slots[1, HITS], f.vts.slots[:2, SURVEYED] = [0, 5], 9, [1, 0]
    assert _displaced(f, b, 100, 3) == 1
    f.count[0] = 1
    assert _displaced(f, b, 100, 3) == -1


def test_the_oracle_takes_a_surveyed_transmitter_for_the_vt_that_it_is(toy_recording: Toy) -> None:
    """The transmitter of site B is the third VT; associations are by the numbers of VTs, not of links."""
    recording = surveyed(toy_recording(80), 0.0, 0.0)
    place = np.where([[False], [True]], recording.truth.site_positions_m, np.nan)
    recording = replace(recording, sites=replace(recording.sites, position_m=place))
    vts = driven(KnownAssociation(), recording, with_truth=True)[-1].vts
    assert vts is not None
    np.testing.assert_allclose(vts.position_m[vts.id == 2], [[20.0, -90.0, 28.0]], atol=1e-6)


def test_a_map_for_the_next_drive_leaves_surveyed_transmitters_out(toy_recording: Toy) -> None:
    for recording, sites in ((surveyed(toy_recording(80), 0.0, 2.0), 1), (surveyed(toy_recording(80), np.nan, 0.0), 2)):
        estimator = EkfSlam()
        driven(estimator, recording)
        known = estimator.vt_map()
        assert known is not None
        there = np.linalg.norm(known.position_m[:, None] - recording.truth.site_positions_m, axis=2) < 8.0
        assert there.any(axis=0).sum() == sites


@pytest.mark.slow
def test_lines_of_sight_of_surveyed_sites_tell_the_clock_offsets_at_once() -> None:
    """Offsets are unknown to 150 m; by the bound they are known to 0.25 m after 100 snapshots."""
    known = {f"sites.{site}.known": True for site in "AB"}
    recording = simulate("tiny", 7, 0, overrides=known)
    found = driven(EkfSlam(), recording, 100)[-1]
    assert found.clock_offset_m is not None and found.clock_offset_variance_m2 is not None
    assert np.sqrt(found.clock_offset_variance_m2).max() < 0.5
    assert recording.truth is not None
    assert np.abs(found.clock_offset_m - recording.truth.clock_offsets_m).max() < 1.0
