"""The bound with errors that persist: against plain recursions, exact correlations, and the fields that are drawn."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from cellslam.benchmarks.bound import persisting_states as bound_persisting
from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.bound.linear_model import core_of, linear_motion, start_variance
from cellslam.benchmarks.bound.persisting_states import bell_functions
from cellslam.sim.errors import InputError
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.persisting_errors import causes, persisting_std
from cellslam.sim.recording import Recording
from cellslam.slam.model.measurement_model import jacobians, predict
from tests.benchmarks.bound.joint_filter import JointFilter, apart

WHITE = (0.15, np.radians(0.3), np.radians(0.3))
# Odometry so poor that the measurements decide.
POOR = {"std": (0.1, np.radians(0.2), np.radians(0.2)), "noise_density": (0.3, 0, 0, 0.015, 0, 0)}


def persisting(recording: Recording, **radio: object) -> Recording:
    """A copy whose errors have, beside the white ones, those of a radio configuration."""
    config = RadioConfig(**{"roof_correlation_deg": 6.0, **radio})  # type: ignore[arg-type]
    truth = recording.truth
    assert truth is not None
    std = np.where(np.isnan(truth.measurement_std), np.nan, persisting_std(config))
    total = np.sqrt(truth.measurement_std**2 + std**2)
    provenance = {"world": {"radio": config.model_dump(mode="json")}}
    return replace(recording, provenance=provenance, truth=replace(truth, measurement_std=total, persisting_std=std))


def radio_of(recording: Recording) -> RadioConfig:
    return RadioConfig(**recording.provenance["world"]["radio"])


def all_white(recording: Recording) -> Recording:
    """The same deviations, redrawn for each measurement."""
    assert recording.truth is not None
    return replace(recording, truth=replace(recording.truth, persisting_std=None))


def exact_horizontal_std(recording: Recording, at: int) -> float:
    """The bound after snapshot `at` from all measurements at once, with the fields' own correlations."""
    truth, m, config = recording.truth, recording.measurements, radio_of(recording)
    assert truth is not None
    core = core_of(recording.odometry_model, recording.sites)
    F, Q = linear_motion(recording, truth, core)
    maps = [np.diag(np.sqrt(start_variance(recording, core)))]
    for t in range(1, at + 1):
        value, vector = np.linalg.eigh(Q[t])
        keep = value > 1e-13 * value.max()
        maps.append(np.hstack([F[t] @ maps[-1], vector[:, keep] * np.sqrt(value[keep])]))
    rows = np.flatnonzero((truth.measurement_vt >= 0) & (m.snapshot <= at))
    t, vt, link = m.snapshot[rows], truth.measurement_vt[rows], m.link[rows]
    by_vt, by_pose = jacobians(truth.poses[t], truth.vts.position_m[vt])
    _, key = np.unique(vt, return_inverse=True)
    unknown = maps[-1].shape[1]
    a = np.zeros((len(rows), 3, unknown + 3 * (key.max() + 1)))
    for i in range(len(rows)):
        width = maps[t[i]].shape[1]
        a[i, :, :width] = by_pose[i] @ maps[t[i]][:6]
        a[i, 0, :width] += maps[t[i]][core.offsets[recording.links.site[link[i]]]]
        a[i, :, unknown + 3 * key[i] : unknown + 3 * key[i] + 3] = by_vt[i]
    covariance = exact_covariance(recording, config, rows)
    a = solve_triangular(np.linalg.cholesky(covariance), a.reshape(3 * len(rows), -1), lower=True)
    information = a.T @ a
    information[np.arange(unknown), np.arange(unknown)] += 1
    scale = 1 / np.sqrt(np.diag(information))
    p = (np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale)[:unknown, :unknown]
    return float(np.sqrt(np.trace(maps[-1][:2] @ p @ maps[-1][:2].T)))


def exact_covariance(recording: Recording, config: RadioConfig, rows: np.ndarray) -> np.ndarray:
    """Covariance (3 n, 3 n) of measurement errors: every field has the correlation exp(-x^2 / (2 scale^2))."""
    truth, t = recording.truth, recording.measurements.snapshot[rows]
    assert truth is not None and truth.persisting_std is not None
    vt, port = truth.measurement_vt[rows], recording.links.port[recording.measurements.link[rows]]
    _, azimuth, elevation = predict(truth.poses[t], truth.vts.position_m[vt]).T
    flat, tangent = np.cos(elevation), np.tan(elevation)
    u = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], 1)
    own = (vt[:, None] == vt) & (port[:, None] == port)

    def fields(x: np.ndarray, scale: float) -> np.ndarray:
        return np.exp(-((x[:, None] - x) ** 2).sum(2) / (2 * scale**2))

    calibration, roof, diffuse, attitude = causes(config)
    time = fields(recording.time_s[t][:, None], attitude.scale)
    yaw = np.stack([np.zeros(len(t)), -np.ones(len(t)), np.zeros(len(t))], 1)
    pitch = np.stack([np.zeros(len(t)), tangent * np.sin(azimuth), np.cos(azimuth)], 1)
    roll = np.stack([np.zeros(len(t)), tangent * np.cos(azimuth), -np.sin(azimuth)], 1)
    out = np.zeros((len(t), 3, len(t), 3))
    for turn, std in ((yaw, attitude.std[1]), (pitch, attitude.std[2]), (roll, attitude.std[2])):
        out += std**2 * turn[:, :, None, None] * turn * time[:, None, :, None]
    for c in range(3):
        out[:, c, :, c] += calibration.std[c] ** 2 * fields(u, calibration.scale)
        out[:, c, :, c] += roof.std[c] ** 2 * fields(u, roof.scale)
        out[:, c, :, c] += diffuse.std[c] ** 2 * fields(truth.poses[t, :3], diffuse.scale) * own
        white = truth.measurement_std[rows, c] ** 2 - truth.persisting_std[rows, c] ** 2
        out[np.arange(len(t)), c, np.arange(len(t)), c] += white
    return out.reshape(3 * len(t), -1)


@pytest.mark.parametrize("drift_m_s", [None, 0.3])
def test_bound_equals_the_joint_recursion_with_the_same_states(make_recording, monkeypatch, drift_m_s):
    recording = make_recording(
        seed=3, snapshots=40, vts_per_site=3, detection=0.5, std=WHITE, start_std=(1, 2, 0.5, 0.05, 0.01, 0.01),
    )  # fmt: skip
    # Roof in bells (more principal functions than allowed), calibration in principal functions.
    monkeypatch.setattr(bound_persisting, "MOST_FUNCTIONS", 8)
    recording = persisting(recording, roof_correlation_deg=2.0)
    if drift_m_s is not None:
        std = np.full(len(recording.sites), drift_m_s)
        recording = replace(recording, sites=replace(recording.sites, clock_drift_std_m_s=std))
    joint, result = JointFilter(recording), bound(recording)
    pose, offset, error = joint.run()
    assert apart(result.pose_covariance, pose) < 1e-5
    np.testing.assert_allclose(result.clock_offset_std_m, offset, rtol=1e-5)
    np.testing.assert_allclose(result.pose_error, error, atol=1e-5)
    assert set(joint.drive.states.kind) == {0, 1, 2} and (joint.drive.views.state < 0).any()
    assert joint.size < 800


# Far from right if attitude is halved (3.6 % below), or one diffuse error serves both ports (15 % above). The roof's
# errors are summed up in bell functions, or, of 20 degrees, in principal functions.
@pytest.mark.parametrize(
    ("radio", "drive", "off"),
    [
        ({"roof_correlation_deg": 2.0}, {"snapshots": 180, "std": WHITE}, 0.02),
        ({"roof_correlation_deg": 20.0}, {"snapshots": 180, "std": WHITE}, 0.02),
        ({"attitude_azimuth_deg": 3.0, "attitude_elevation_deg": 3.0, "attitude_correlation_s": 2.0}, POOR, 0.01),
        ({"specular_to_diffuse_db": 0.0, "diffuse_correlation_m": 1.0}, {"ports": 2, "detection": 0.6, **POOR}, 0.03),
    ],
    ids=["roof in bells", "roof in principal functions", "attitude", "diffuse"],
)
def test_bound_is_that_of_the_exact_correlations(make_recording, radio, drive, off):
    same = {"seed": 21, "snapshots": 120, "ports": 1, "vts_per_site": 3, "detection": 0.9}
    recording = persisting(make_recording(**same | drive), **radio)
    exact = exact_horizontal_std(recording, len(recording.time_s) - 1)
    assert bound(recording).horizontal_std_m[-1] == pytest.approx(exact, rel=off)
    assert bound(all_white(recording)).horizontal_std_m[-1] < 0.9 * exact


def test_nothing_that_persists_is_the_white_bound(make_recording):
    recording = make_recording(seed=6, snapshots=80, std=WHITE)
    names = ("calibration_correlation_deg", "roof_correlation_deg", "diffuse_correlation_m", "attitude_correlation_s")
    zero = persisting(recording, **dict.fromkeys(names, 0.0))
    expected = bound(recording).pose_covariance
    np.testing.assert_array_equal(bound(zero).pose_covariance, expected)
    small = bound(persisting(recording, noise_scale=1e-5)).pose_covariance
    np.testing.assert_allclose(small, expected, rtol=1e-5, atol=1e-12)


def test_larger_persisting_errors_never_lower_the_bound(make_recording):
    recording = make_recording(seed=6, snapshots=100, clutter=0.5, **POOR)
    stds = [bound(persisting(recording, noise_scale=scale)).horizontal_std_m for scale in (0.0, 0.3, 1.0, 3.0)]
    assert all((low <= high + 1e-12).all() for low, high in pairwise(stds))
    assert 1.5 * stds[0][-1] < stds[3][-1]


def test_bell_functions_near_the_pole():
    azimuth, elevation = np.linspace(-3, 3, 50), np.linspace(1.4, np.pi / 2, 50)
    cell, value = bell_functions(azimuth, elevation, 0.05)
    assert np.isfinite(value).all()
    np.testing.assert_allclose((value**2).sum(1), 1.0)
    assert all(len(set(row[row >= 0])) == (row >= 0).sum() for row in cell)


def test_recordings_that_do_not_say_their_causes_are_refused(make_recording):
    recording = persisting(make_recording(snapshots=20, std=WHITE))
    with pytest.raises(InputError, match=r"world\.radio"):
        bound(replace(recording, provenance={}))
    other = {"world": {"radio": RadioConfig(roof_azimuth_deg=3.0).model_dump()}}
    with pytest.raises(InputError, match="agree"):
        bound(replace(recording, provenance=other))


def test_errors_that_all_links_share_are_not_averaged_over_links(make_recording):
    one, four = (make_recording(seed=7, snapshots=120, ports=ports, detection=1.0, **POOR) for ports in (1, 4))
    radio = {"calibration_distance_m": 0.6, "roof_azimuth_deg": 2.0, "specular_to_diffuse_db": 40.0}
    one, four = persisting(one, **radio), persisting(four, **radio)
    gain = bound(one).position_rmse_m / bound(four).position_rmse_m
    gain_white = bound(all_white(one)).position_rmse_m / bound(all_white(four)).position_rmse_m
    assert 1.0 <= gain < 1.0 + 0.6 * (gain_white - 1.0)
