"""The bound of drives that share a map: against a plain joint recursion that goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.bound.shared_maps import shared_map_bounds
from cellslam.benchmarks.scores.belief import squared_error
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam.model.measurement_model import predict
from tests.benchmarks.bound.joint_filter import JointFilter, apart

SITES = np.array([[80.0, -40.0, 30.0], [-60.0, 90.0, 25.0]])
WALLS = np.array([[0.3, 60.0], [2.0, 45.0], [-1.2, 70.0]])  # azimuth of the normal in rad, distance in m
DRIVE = {"snapshots": 50, "detection": 0.6, "clutter": 0.0, "vts_per_site": 4}


def mirrored(site: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """A site as its reflection is heard; a wall of NaN: as itself."""
    if np.isnan(wall).any():
        return site
    n = np.array([np.cos(wall[0]), np.sin(wall[0]), 0.0])
    return site - 2.0 * (n @ site - wall[1]) * n


@pytest.fixture
def drives(make_recording) -> list[Recording]:
    """Two drives past two sites and three walls: each site is heard directly and over each wall."""
    out = []
    for seed in (1, 2):
        recording = make_recording(seed=seed, **DRIVE)
        vts, walls = recording.truth.vts, np.vstack([[np.nan, np.nan], WALLS])
        facet = np.tile(np.arange(-1, 3), 2)
        places = [mirrored(SITES[s], walls[f + 1]) for s, f in zip(vts.site, facet, strict=True)]
        facets = np.stack([facet, np.full(8, -1)], axis=1)
        vts = replace(vts, position_m=np.array(places), order=(facet >= 0).astype(np.int64), facets=facets)
        out.append(replace(recording, truth=replace(recording.truth, vts=vts, site_positions_m=SITES)))
    assert np.array_equal(out[0].truth.vts.site, np.repeat([0, 1], 4))
    return out


def test_the_first_of_several_drives_is_as_it_is_alone(drives):
    alone = bound(drives[0])
    first, second = shared_map_bounds(drives)
    np.testing.assert_allclose(first.pose_covariance, alone.pose_covariance, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(first.pose_error, alone.pose_error, rtol=1e-6, atol=1e-9)
    assert second.position_rmse_m < 0.9 * bound(drives[1]).position_rmse_m


def test_the_second_drive_goes_on_with_the_map_alone(drives):
    first = JointFilter(drives[0], broad_std=1e4)
    first.run()
    vts = slice(first.core.size, first.errors)
    pose, offset, _ = JointFilter(drives[1], known=first.P[vts, vts]).run()
    _, second = shared_map_bounds(drives)
    assert apart(second.pose_covariance, pose) < 1e-4
    np.testing.assert_allclose(second.clock_offset_std_m, offset, rtol=1e-4)


@pytest.mark.slow
def test_what_the_filter_errs_fits_what_it_is_sure_of(make_recording, drives):
    """The second drive's filter, with the errors of map and measurements as they were drawn: NEES of 2 on average."""

    def measured(seed: int, map_of: Recording) -> Recording:
        """Another drive past the same VTs."""
        drawn, vts = make_recording(seed=100 + seed, **DRIVE), map_of.truth.vts
        m, truth = drawn.measurements, replace(drawn.truth, vts=vts, site_positions_m=SITES)
        z = predict(truth.poses[m.snapshot], vts.position_m[truth.measurement_vt])
        z[:, 0] += truth.clock_offsets_m[drawn.links.site[m.link]]
        z += truth.measurement_std * np.random.default_rng(seed).standard_normal(z.T.shape).T
        of = replace(m, distance_m=z[:, 0], azimuth_rad=z[:, 1], elevation_rad=z[:, 2])
        return replace(drawn, truth=truth, measurements=of)

    squares = []
    for seed in range(30):
        *_, last = shared_map_bounds([measured(2 * seed + i, one) for i, one in enumerate(drives)])
        squares.append(squared_error(last.pose_error[:, :2], last.pose_covariance[:, :2, :2])[-1])
    assert 1.2 < np.mean(squares) < 3.0


def test_a_survey_counts_once_in_a_map(drives):
    """The second drive has it by the map: neither again, nor as a birth."""
    known = [
        replace(d, sites=replace(d.sites, position_m=SITES + 1.0, position_std_m=np.full(SITES.shape, 2.0)))
        for d in drives
    ]
    first = JointFilter(known[0], broad_std=1e4)
    first.run()
    vts = slice(first.core.size, first.errors)
    pose, *_ = JointFilter(known[1], known=first.P[vts, vts]).run()
    _, second = shared_map_bounds(known)
    assert apart(second.pose_covariance, pose) < 1e-4


def test_what_cannot_share_a_map_is_refused(make_recording, drives):
    elsewhere = replace(drives[1], truth=replace(drives[1].truth, site_positions_m=SITES + 1.0))
    with pytest.raises(InputError, match="sites of the recordings are not the same"):
        list(shared_map_bounds([drives[0], elsewhere]))
