"""The bound against a plain joint Kalman recursion, a Monte Carlo of the filter, and properties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import Joint, bound
from cellslam.benchmarks.bound.linear_model import geometry_of, pose_jacobians
from cellslam.sim.errors import InputError
from cellslam.sim.frames import integrate_pose, mean_velocity
from cellslam.sim.recording import Recording
from cellslam.slam.model.measurement_model import predict
from tests.benchmarks.bound.joint_filter import JointFilter, apart


def keep_rows(recording: Recording, keep: np.ndarray) -> Recording:
    """A copy with some of the measurements."""
    m, truth = recording.measurements, recording.truth
    assert truth is not None
    columns = {k: v[keep] for k, v in vars(m).items() if v is not None}
    truth = replace(truth, measurement_vt=truth.measurement_vt[keep], measurement_std=truth.measurement_std[keep])
    return replace(recording, measurements=replace(m, **columns), truth=truth)


def test_bound_equals_the_joint_kalman_recursion(make_recording):
    recording = make_recording(
        seed=3, snapshots=60, vts_per_site=3, detection=0.5, bias_walk_density=(0, 0, 0, 0.02, 0, 0),
        start_std=(1, 2, 0.5, 0.05, 0.01, 0.01),
    )  # fmt: skip
    pose, offset, _ = JointFilter(recording).run()
    result = bound(recording)
    assert apart(result.pose_covariance, pose) < 1e-5
    np.testing.assert_allclose(result.clock_offset_std_m, offset, rtol=1e-5)
    assert offset[-1].max() < 0.9 * offset[0].min()


def surveyed(recording: Recording, std_m: float, seed: int = 0) -> Recording:
    """A copy whose first VT of each site is its transmitter, surveyed with errors that are drawn."""
    truth = recording.truth
    assert truth is not None
    site_m = truth.vts.position_m[np.searchsorted(truth.vts.site, np.arange(len(recording.sites)))]
    error_m = std_m * np.random.default_rng(seed).standard_normal(site_m.shape)
    sites = replace(recording.sites, position_m=site_m + error_m, position_std_m=np.full(site_m.shape, std_m))
    return replace(recording, sites=sites, truth=replace(truth, site_positions_m=site_m))


@pytest.mark.parametrize("std_m", [0.0, 3.0])
def test_surveyed_transmitters_are_states_with_the_variance_of_the_survey(make_recording, std_m):
    recording = surveyed(make_recording(seed=3, snapshots=60, vts_per_site=3, detection=0.5), std_m)
    plain = JointFilter(recording)
    pose, offset, error = plain.run()
    assert np.diag(plain.drive.prior.variance).max() == std_m**2
    result = bound(recording)
    assert apart(result.pose_covariance, pose) < 1e-5
    np.testing.assert_allclose(result.clock_offset_std_m, offset, rtol=1e-5)
    np.testing.assert_allclose(result.pose_error, error, rtol=1e-3, atol=1e-6)


def test_the_more_exact_a_survey_is_the_lower_is_the_bound(make_recording):
    recording = make_recording(seed=3, snapshots=120, vts_per_site=3)
    found, without = [bound(surveyed(recording, std_m)) for std_m in (0.0, 1.0, 10.0, 1e5)], bound(recording)
    for stds in ([b.position_rmse_m for b in found], [b.clock_offset_std_m[-1, 0] for b in found]):
        assert stds == sorted(stds) and stds[0] < 0.999 * stds[2]
    assert found[1].clock_offset_std_m[-1, 0] == pytest.approx(1.0, abs=0.3)  # that of the survey
    assert found[3].position_rmse_m == pytest.approx(without.position_rmse_m, rel=1e-3)


def scattering(recording: Recording, chosen: list[int]) -> Recording:
    """A copy in which some VTs, not those of order 0, are scatterers of their sites."""
    truth, m = recording.truth, recording.measurements
    assert truth is not None
    kind = np.isin(np.arange(len(truth.vts)), chosen).astype(np.int64)
    site_m = truth.vts.position_m[np.searchsorted(truth.vts.site, np.arange(len(recording.sites)))]
    excess_m = kind * np.linalg.norm(truth.vts.position_m - site_m[truth.vts.site], axis=1)
    truth = replace(truth, vts=replace(truth.vts, scatterer=kind), site_positions_m=site_m)
    further = np.where(truth.measurement_vt >= 0, excess_m[truth.measurement_vt], 0.0)
    return replace(recording, truth=truth, measurements=replace(m, distance_m=m.distance_m + further))


@pytest.mark.parametrize("survey_std_m", [None, 3.0])
def test_scatterers_are_states_and_so_is_the_site_that_illuminates_them(make_recording, survey_std_m):
    recording = scattering(make_recording(seed=3, snapshots=60, vts_per_site=4, detection=0.5), [1, 3, 6])
    if survey_std_m is not None:
        recording = surveyed(recording, survey_std_m)
    plain = JointFilter(recording)
    pose, offset, error = plain.run()
    result = bound(recording)
    assert apart(result.pose_covariance, pose) < 1e-5
    np.testing.assert_allclose(result.clock_offset_std_m, offset, rtol=1e-5)
    np.testing.assert_allclose(result.pose_error, error, rtol=1e-3, atol=1e-6)
    # What is measured is what the truth predicts, but for white noise.
    s = plain.drive.sightings
    normalised = s.residual[:, 0] ** 2 / s.variance[:, 0]
    assert normalised[np.isfinite(s.variance[:, 0])].mean() == pytest.approx(1.0, abs=0.2)


def test_jacobians_of_scatterers_agree_with_finite_differences(make_recording):
    recording = scattering(make_recording(seed=3, snapshots=12, vts_per_site=4), [1, 3])
    truth, vt = recording.truth, np.arange(8)
    pose = truth.poses[:8]
    geometry = geometry_of(truth, pose, vt)
    away = truth.vts.position_m[[1, 3]] - truth.site_positions_m[0]
    direct = predict(pose, truth.vts.position_m)[:, 0]
    more = np.zeros(8)
    more[[1, 3]] = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(geometry.predicted[:, 0], direct + more)
    assert not geometry.by_site[[0, 2, 4, 5, 6, 7]].any() and not geometry.by_site[:, 1:].any()
    for c in range(3):
        step = 1e-4 * np.eye(3)[c]
        by_vt, by_site = [], []
        for sign in (1.0, -1.0):
            moved = replace(truth, vts=replace(truth.vts, position_m=truth.vts.position_m + sign * step))
            by_vt.append(geometry_of(moved, pose, vt).predicted)
            moved = replace(truth, site_positions_m=truth.site_positions_m + sign * step)
            by_site.append(geometry_of(moved, pose, vt).predicted)
        np.testing.assert_allclose(geometry.by_vt[..., c], (by_vt[0] - by_vt[1]) / 2e-4, atol=1e-7)
        np.testing.assert_allclose(geometry.by_site[..., c], (by_site[0] - by_site[1]) / 2e-4, atol=1e-7)


def test_a_scatterer_tells_more_with_its_site_and_without_a_vt_there_is_no_bound(make_recording):
    recording = scattering(make_recording(seed=3, snapshots=120, vts_per_site=3), [1, 2, 4, 5])
    truth = recording.truth
    mirrors = ~truth.vts.scatters[truth.measurement_vt] | (truth.measurement_vt < 0)
    with_all, without = bound(recording), bound(keep_rows(recording, mirrors))
    assert (with_all.horizontal_std_m <= without.horizontal_std_m + 1e-9).all()
    assert with_all.position_rmse_m < 0.99 * without.position_rmse_m
    elsewhere = replace(truth, site_positions_m=truth.site_positions_m + 1.0)
    with pytest.raises(InputError, match="without the site"):
        bound(replace(recording, truth=elsewhere))


def test_absent_components_carry_no_information(make_recording):
    full = make_recording(seed=4, snapshots=60, vts_per_site=3, detection=0.6)
    m, rng = full.measurements, np.random.default_rng(0)
    columns = {}
    # A row has a distance, or an azimuth, or both; elevations are absent now and then.
    absent = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]], bool)[rng.integers(0, 5, len(m))]
    for name, gone in zip(("distance_m", "azimuth_rad", "elevation_rad"), absent.T, strict=True):
        columns[name] = np.where(gone, np.nan, getattr(m, name))
    partial = replace(full, measurements=replace(m, **columns))
    pose, offset, _ = JointFilter(partial, broad_std=3e3).run()
    result = bound(partial)
    np.testing.assert_allclose(result.horizontal_std_m, np.sqrt(pose[:, 0, 0] + pose[:, 1, 1]), rtol=2e-3)
    np.testing.assert_allclose(result.clock_offset_std_m, offset, rtol=2e-2)
    assert (result.horizontal_std_m >= bound(full).horizontal_std_m - 1e-9).all()


def test_more_measurements_never_raise_the_bound_and_clutter_does_not_count(make_recording):
    recording = make_recording(seed=6, snapshots=120, clutter=1.0)
    true = recording.truth.measurement_vt >= 0
    some = np.random.default_rng(1).random(len(true)) < 0.5
    stds = [bound(keep_rows(recording, keep)).horizontal_std_m for keep in (true, true & some, true & False)]
    np.testing.assert_array_equal(bound(recording).horizontal_std_m, stds[0])
    assert (stds[0] <= stds[1] + 1e-12).all() and (stds[1] <= stds[2] + 1e-12).all()
    assert stds[0][-1] < stds[2][-1]


def test_known_offsets_lower_the_bound(make_recording):
    recording = make_recording(seed=8, snapshots=300, offset_std_m=20.0)
    sites = replace(recording.sites, clock_offset_std_m=np.zeros(2))
    known, unknown = bound(replace(recording, sites=sites)), bound(recording)
    assert (known.horizontal_std_m <= unknown.horizontal_std_m + 1e-12).all()
    assert (known.clock_offset_std_m == 0).all() and (unknown.clock_offset_std_m > 0).all()


def test_without_measurements_the_bound_is_dead_reckoning_by_hand(make_recording):
    recording = make_recording(
        seed=9, snapshots=101, noise_density=(0.1, 0, 0, 0, 0, 0), bias=(0,) * 6, bias_walk_density=(0,) * 6,
        scale=(0.02, 0, 0, 0, 0, 0), start_std=(0.3, 0.4, 0, 0, 0, 0),
    )  # fmt: skip
    assert recording.truth is not None
    none = keep_rows(recording, recording.truth.measurement_vt < -1)
    moved = recording.truth.poses[-1, :2] - recording.truth.poses[0, :2]
    factor = 1 / (1 + recording.truth.odometry_scale[0])
    # Start + white noise along the track (density^2 x time) + scale x displacement, in units of the true velocity.
    expected = 0.3**2 + 0.4**2 + (0.1 * factor) ** 2 * 7.5 + (0.02 * factor) ** 2 * (moved**2).sum()
    assert bound(none).horizontal_std_m[-1] ** 2 == pytest.approx(expected, rel=1e-9)


def test_pose_jacobians_agree_with_finite_differences():
    rng = np.random.default_rng(2)
    pose, after = rng.normal(0, 0.5, (20, 6)), rng.normal(0, 0.5, (20, 6))
    dt = rng.uniform(0.1, 0.5, 20)
    velocity = mean_velocity(pose, after, dt)
    by_pose, by_velocity = pose_jacobians(pose, velocity, dt)
    for n in range(20):
        for c in range(6):
            step = 1e-6 * np.eye(6)[c]
            forward, back = (integrate_pose(pose[n] + s * step, velocity[n], dt[n]) for s in (1, -1))
            np.testing.assert_allclose(by_pose[n, :, c], (forward - back) / 2e-6, atol=1e-8)
            forward, back = (integrate_pose(pose[n], velocity[n] + s * step, dt[n]) for s in (1, -1))
            np.testing.assert_allclose(by_velocity[n, :, c], (forward - back) / 2e-6, atol=1e-8)


@pytest.mark.parametrize("std", [(0.0, 0.0, 0.0), (1e-9, 1e-9, 1e-9)])
def test_measurements_without_noise_stay_healthy(make_recording, std):
    result = bound(make_recording(seed=10, snapshots=400, ports=3, std=std, start_std=(0, 0, 0, 0, 0, 0)))
    variance = np.einsum("tii->ti", result.pose_covariance)
    assert np.isfinite(variance).all() and (variance >= 0).all()
    # No VT is seen in the first snapshots, so some of the odometry's error stays for good; the offsets are found.
    assert 0 < result.position_rmse_m < 0.04 and (result.clock_offset_std_m[-1] < 1e-3).all()


def test_a_vt_overhead_and_one_at_the_array_are_left_out(make_recording):
    recording = make_recording(seed=12, snapshots=50)
    truth, at = recording.truth, recording.measurements.snapshot
    assert truth is not None
    position = truth.vts.position_m.copy()
    for vt, above_m in ((0, 30.0), (1, 0.0)):
        row = np.flatnonzero(truth.measurement_vt == vt)[20]
        position[vt] = truth.poses[at[row], :3] + [0, 0, above_m]
    vts = replace(truth.vts, position_m=position)
    result = bound(replace(recording, truth=replace(truth, vts=vts)))
    assert np.isfinite(result.pose_covariance).all()


def test_no_truth_no_bound(make_recording):
    with pytest.raises(InputError, match="no truth"):
        bound(replace(make_recording(snapshots=5), truth=None))


def test_sectors_of_a_port_are_one_measurement_and_ports_share_the_map(make_recording):
    recording = make_recording(seed=4, snapshots=60, ports=2, detection=1.0)
    links, std = recording.links, recording.truth.measurement_std
    halved = replace(recording, truth=replace(recording.truth, measurement_std=std / np.sqrt(2.0)))
    merged = replace(recording, links=replace(links, port=np.zeros_like(links.port)))
    one = keep_rows(halved, links.port[recording.measurements.link] == 0)
    np.testing.assert_allclose(bound(merged).pose_covariance, bound(one).pose_covariance, rtol=1e-6, atol=1e-12)


def test_the_capacity_of_the_arrays_changes_nothing(
    make_recording: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Arrays that are always full have no empty row at their end, which a state that is not there might hit."""
    recording = make_recording(seed=3, snapshots=60, vts_per_site=3, detection=0.5)
    expected = bound(recording)
    grow = Joint._grow
    monkeypatch.setattr(Joint, "_grow", lambda joint, size: grow(joint, size // 2))
    found = bound(recording)
    np.testing.assert_allclose(found.pose_covariance, expected.pose_covariance, rtol=1e-9, atol=1e-12)
