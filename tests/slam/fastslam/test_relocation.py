"""A vehicle that is put down anywhere in a remembered map: its groups of particles, and where the filter finds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.relocation import components_of_pose
from cellslam.slam.model.vt_map import VtMap
from tests.slam.fastslam.drives import VTS, WHITE, Drive, driven, street

STD = np.array([15.0, 15.0, 0.0, 0.5, 0.0, 0.0])


def remembered() -> VtMap:
    """Return a map of the street's VTs, known to half a metre, and of 60 that are not seen on this drive."""
    rng = np.random.default_rng(3)
    places = np.concatenate([VTS, rng.normal(0.0, [600.0, 600.0, 20.0], (60, 3))])
    count = len(places)
    return VtMap(
        site=np.repeat("A", count), cell_id=np.zeros(count, np.int64), port=np.zeros(count, np.int64),
        position_m=places + 0.5 * rng.standard_normal((count, 3)), anchor_m=np.zeros((count, 3)),
        own_m2=np.tile(0.25 * np.eye(3), (count, 1, 1)), common_m=np.zeros((count, 3, 0)),
        seen_m=np.tile([[-100.0, -100.0], [200.0, 100.0]], (count, 1, 1)), hits=np.full(count, 50),
        missed=np.zeros(count, np.int64),
    )  # fmt: skip


def put_down(away: Floats, std: Floats = STD) -> Drive:
    """Return a drive that begins `away` (6,) from where it is assumed to."""
    setup, steps = street(60, seed=4)
    return replace(setup, start_pose=away, start_std=std, map=remembered()), steps


@pytest.mark.parametrize("std", [np.array([15.0, 10.0, 0.5]), np.array([8.0, 2.0, 0.01])])
def test_components_are_the_prior(std: Floats) -> None:
    offsets, log_weight, widths = components_of_pose(std, np.array([3.0, 3.0, np.radians(5.0)]), step=1.25)
    weight = np.exp(log_weight) / np.exp(log_weight).sum()
    np.testing.assert_allclose(weight @ offsets, 0.0, atol=1e-9)
    # What lies beyond four deviations is left out.
    np.testing.assert_allclose(weight @ offsets**2 + widths**2, std**2, rtol=0.02)


def test_headings_are_met_once() -> None:
    offsets = components_of_pose(np.array([1.0, 1.0, np.pi]), np.array([3.0, 3.0, 0.1]), step=1.25)[0]
    assert np.abs(offsets[:, 2]).max() <= np.pi
    assert len(np.unique(offsets[:, 2])) == len(offsets) == 51


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_vehicle_is_found_to_a_metre_wherever_it_is_put_down(seed: int) -> None:
    away = np.clip(STD * np.random.default_rng(seed).standard_normal(6), -2.5 * STD, 2.5 * STD)
    fastslam = FastSlam(FastSlamOptions(**WHITE))
    answers = driven(fastslam, put_down(away))
    assert np.abs(answers[-1].pose[[0, 1, 3]] - [5.9, 0.0, 0.0]).max() < 1.0 and not fastslam.remarks()


def test_no_groups_begin_where_the_start_is_known() -> None:
    fastslam = FastSlam(FastSlamOptions(**WHITE))
    driven(fastslam, put_down(np.zeros(6), np.array([0.5, 0.5, 0.0, 0.01, 0.0, 0.0])))
    assert fastslam._joint is not None and len(fastslam._joint) == 1
