"""What no measurement can show, a common shift and turn of vehicle and VTs, stays unknown when the estimate moves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from tests.slam.driving import driven
from tests.slam.scattered_worlds import WHITE, world

POSE = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2])
VTS, ANCHOR = ([90.0, 2.5, 0.3], [40.0, -1.0, -0.1]), (-4.0, 6.0, 2.0)


def moved(one: Any, x: Floats, by: Floats) -> Floats:
    """Return the state x with vehicle and VTs turned about the origin and shifted: `by` x, y, z (m) and yaw (rad)."""
    c, s = np.cos(by[3]), np.sin(by[3])
    turn, out = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), x.copy()
    out[:3], out[3] = turn @ x[:3] + by[:3], x[3] + by[3]
    one.f.x[: one.n] = x
    for j in range(one.f.count[0]):
        way = turn @ one.place(j) + by[:3] - ANCHOR
        flat = np.hypot(way[0], way[1])
        out[one.f.vts.state[j, :3]] = np.hypot(flat, way[2]), np.arctan2(way[1], way[0]), np.arctan2(way[2], flat)
    return out


def unseen(one: Any, x: Floats) -> Floats:
    """Return the directions (n, 4) of the state in which `moved` goes."""
    steps = 1e-6 * np.eye(4)
    return np.array([(moved(one, x, step) - moved(one, x, -step)) / 2e-6 for step in steps]).T


@pytest.fixture
def states(one_filter: Any) -> tuple[Any, Floats, Floats]:
    """A filter with two VTs; its state before and after an update."""
    one = one_filter()
    one.put(POSE, 15.0, *VTS, anchor=ANCHOR)
    before = one.f.x[: one.n].copy()
    return one, before, before + np.random.default_rng(3).normal(size=one.n) * 0.05


def carried(one: Any, before: Floats, after: Floats, p: Floats) -> Floats:
    one.f.p[: one.n, : one.n], one.f.x[: one.n] = p, after
    carry_over(one.f, before, np.full((4, len(one.f.x)), np.nan))
    return np.array(one.f.p[: one.n, : one.n])


def test_what_is_unknown_of_the_frame_stays_unknown(states: tuple[Any, Floats, Floats]) -> None:
    one, before, after = states
    old, new = unseen(one, before), unseen(one, after)
    root = np.random.default_rng(5).normal(size=(4, 4))
    p = carried(one, before, after, old @ root @ root.T @ old.T)
    np.testing.assert_allclose(p, new @ root @ root.T @ new.T, rtol=1e-6, atol=1e-6)


def test_all_else_is_kept_as_seen_from_the_vehicle(states: tuple[Any, Floats, Floats]) -> None:
    """The kept errors: of place, less what the yaw does to it; of a VT, less what those of place and yaw do."""
    one, before, after = states

    def kept(x: Floats) -> Floats:
        out, directions = np.eye(one.n), unseen(one, x)
        directions[:, 3] -= directions[:, :3] @ directions[:3, 3]  # a turn about the vehicle
        out[0, 3], out[1, 3] = x[1], -x[0]
        vts = one.f.vts.state[:2, :3].ravel()
        out[np.ix_(vts, np.arange(4))] = -directions[vts]
        return out

    root = np.random.default_rng(6).normal(size=(one.n, one.n))
    p = carried(one, before, after, root @ root.T)
    np.testing.assert_array_equal(p, p.T)
    want = kept(before) @ root @ root.T @ kept(before).T
    np.testing.assert_allclose(kept(after) @ p @ kept(after).T, want, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
def test_a_heading_that_nothing_tells_does_not_get_better() -> None:
    """Start unknown by 3 m and 10 degrees: no measurement says where the frame lies, so that the heading stays as
    unknown."""
    unknown = {"vehicle.start_std_m": 3.0, "vehicle.start_std_deg": 10.0, "radio.clock_offset_std_m": 0.0}
    short = {"vehicle.duration_s": 90.0, "vehicle.distance_m": 90.0, "vehicle.stops": 1}
    recording = simulate(load("lund-530", {**unknown, **short}), 79500, 0)
    answer = driven(EkfSlam(), recording)[-1]
    assert np.degrees(np.sqrt(answer.covariance[3, 3])) == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize("estimator", [EkfSlam, FastSlam])
@pytest.mark.parametrize("clock_m", [0.0, 30.0])
def test_a_start_that_is_not_known_changes_no_estimate(estimator: Any, clock_m: float) -> None:
    """Among mirror images and scatterers: whatever is believed of where the world's frame lies, the drive and the map
    within are the same, and as uncertain."""
    drive, unknown = world(5, 0.5, features=20, steps=120).recording, np.array([2.0, 2.0, 0.0, 0.1, 0.0, 0.0])
    recording = replace(drive, sites=replace(drive.sites, clock_offset_std_m=np.full(1, clock_m)))
    sure, unsure = (
        driven(estimator(estimator.Options(**WHITE)), replace(recording, start_std=std))
        for std in (np.zeros(6), unknown)
    )
    for one, other in zip(sure, unsure, strict=True):
        np.testing.assert_allclose(other.pose, one.pose, atol=1e-4)
        x, y = other.pose[:2] - recording.start_pose[:2]
        shift = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        more, plane = shift @ np.diag(unknown[[0, 1, 3]] ** 2) @ shift.T, np.ix_([0, 1, 3], [0, 1, 3])
        np.testing.assert_allclose(other.covariance[plane], one.covariance[plane] + more, rtol=1e-3, atol=1e-4)
