"""Partial recordings: what is missing is declared in the file, and survives it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from cellslam.benchmarks.scores.alignment import aligned
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.recordings import Campaign, OdometryTable, ReferenceTable, build
from cellslam.sim.errors import InputError
from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Recording, Reference
from cellslam.slam.api import odometry_of, snapshots_of

Toy = Callable[..., Recording]


def partial(toy: Toy) -> Recording:
    """No elevation, no SNR, no cells, no truth, odometry of two components with a gap, GNSS at 1 Hz, irregular
    times.
    """
    r = toy(truth=False)
    nothing = np.full(len(r.measurements), np.nan)
    odometry = np.full((len(r.time_s), 6), np.nan)
    odometry[:, [0, 3]] = r.odometry[:, [0, 3]]
    odometry[7:9, 3] = np.nan
    missing, unknown = np.full(len(r.links), -1), np.full(4, np.nan)
    fixes = np.array([[3, -2, np.nan], [4, -1, np.nan], [np.nan] * 3, [5, 1, np.nan]])
    return dataclasses.replace(
        r,
        time_s=r.time_s + 0.03 * np.sin(np.arange(len(r.time_s))),
        odometry=odometry,
        measurements=dataclasses.replace(r.measurements, elevation_rad=nothing, snr_db=nothing),
        links=dataclasses.replace(r.links, cell_id=missing, port=missing),
        reference=Reference(np.arange(4.0), fixes, unknown, unknown),
    )


def test_absences_are_declared_and_come_back(toy_recording: Toy, tmp_path: Path) -> None:
    recording = dataclasses.replace(partial(toy_recording), plane=True)
    recording.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert sorted(file["measurements"].attrs["absent"]) == ["elevation_rad", "snr_db"]
    again = Recording.load(tmp_path / "a.h5")
    assert np.isnan(again.measurements.elevation_rad).all() and np.isnan(again.measurements.snr_db).all()
    assert (again.links.cell_id == -1).all() and again.truth is None and again.plane
    assert again.odometry.tobytes() == recording.odometry.tobytes()
    assert again.reference is not None and recording.reference is not None
    assert again.reference.position_m.tobytes() == recording.reference.position_m.tobytes()


def test_estimators_get_odometry_without_gaps(toy_recording: Toy) -> None:
    recording = partial(toy_recording)
    given = odometry_of(recording)
    assert np.isfinite(given).all() and not given[:, [1, 2, 4, 5]].any()
    assert (given[7:9, 3] == recording.odometry[6, 3]).all()
    assert given[:, 0].tobytes() == recording.odometry[:, 0].tobytes()


def test_in_one_plane_elevations_are_zero_for_estimators(toy_recording: Toy) -> None:
    recording = dataclasses.replace(partial(toy_recording), plane=True)
    assert all((s.elevation_rad == 0).all() for s in snapshots_of(recording))
    with pytest.raises(InputError, match="plane is set"):
        dataclasses.replace(toy_recording(), plane=True)


def result_of(recording: Recording, poses: np.ndarray) -> TrialResult:
    return TrialResult("toy", poses, np.tile(np.diag([4.0, 4, 1, 1, 1, 1]), (len(poses), 1, 1)))


def test_scores_against_a_reference_interpolate_the_estimate(toy_recording: Toy) -> None:
    recording = toy_recording(truth=False)
    straight = np.zeros((40, 6))
    straight[:, 0] = 10.0 * recording.time_s
    times = np.array([-1.0, 0.55, 1.55, 2.55, 99.0])
    known = np.column_stack([10.0 * times, np.full(5, 3.0), np.full(5, np.nan)])
    recording = dataclasses.replace(recording, reference=Reference(times, known, np.full(5, 0.2), np.full(5, 1.0)))
    scores = score(recording, result_of(recording, straight), None)
    assert scores["position_rmse_m"] == pytest.approx(3.0)  # the fixes outside of the drive do not count
    assert scores["position_end_m"] == pytest.approx(3.0)
    assert scores["heading_rmse_rad"] == pytest.approx(0.2)
    assert scores["nees_mean"] == pytest.approx(9.0 / 5.0)  # 2^2 claimed and 1^2 of the reference
    assert scores["map_gospa_m"] is None and scores["association_recall"] is None
    unsaid = dataclasses.replace(recording.reference, position_std_m=np.full(5, np.nan))
    exact = score(dataclasses.replace(recording, reference=unsaid), result_of(recording, straight), None)
    assert exact["nees_mean"] == pytest.approx(9.0 / 4.0)


def test_alignment_removes_a_rigid_motion(toy_recording: Toy) -> None:
    recording = toy_recording()
    assert recording.truth is not None
    c, s = np.cos(0.7), np.sin(0.7)
    poses = recording.truth.poses.copy()
    poses[:, :2] = poses[:, :2] @ np.array([[c, s], [-s, c]]) + [100.0, -50.0]
    poses[:, 3] += 0.7
    moved = result_of(recording, poses)
    assert score(recording, moved, None)["position_rmse_m"] > 50.0  # type: ignore[operator]
    scores = score(recording, aligned(recording, moved), None)
    assert scores["position_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert scores["heading_rmse_rad"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("hold", ["next", "before", "linear"])
def test_odometry_at_another_rate_integrates_to_the_same_drive(hold: str) -> None:
    """A quarter circle at 40 Hz, snapshots at irregular times: the means lead to the true poses."""
    fine = np.linspace(0.0, 10.0, 401)
    rng = np.random.default_rng(3)
    times = np.sort(np.append(rng.uniform(0.0, 10.0, 60), [0.0, 10.0]))
    rate, speed = np.pi / 20.0, 2.0
    constant = {"u_x": np.full(401, speed), "u_psi": np.full(401, rate)}
    table = OdometryTable(fine, constant, hold, lever_arm_m=(1.0, 0.5, 0.0))
    recording = build(Campaign(times, {"distance_m": times}, table, start_pose=(0.0,) * 6))
    pose = recording.start_pose
    for t in range(1, len(times)):
        pose = integrate_pose(pose, odometry_of(recording)[t], times[t] - times[t - 1])
    radius = speed / rate
    # The array sits (1, 0.5) from the point that drives the circle, which starts at minus that.
    vehicle = np.array([radius, radius]) - [1.0, 0.5]
    assert pose[:2] == pytest.approx(vehicle + np.array([-0.5, 1.0]), abs=2e-3)
    assert pose[3] == pytest.approx(np.pi / 2)
    assert np.isnan(recording.odometry[:, [2, 4, 5]]).all()


def test_where_odometry_pauses_nothing_is_made_up() -> None:
    times = np.arange(0.0, 20.0, 0.5)
    own = times[(times < 5.0) | (times > 12.0)]
    table = OdometryTable(own, {"u_x": np.ones(len(own))})
    recording = build(Campaign(times, {"azimuth_rad": 0.1 * np.ones(40)}, table, start_pose=(0.0,) * 6))
    unknown = np.isnan(recording.odometry[1:, 0])
    assert unknown[10:23].all() and not unknown[:9].any() and not unknown[25:].any()


def test_commands_hold_through_a_pause() -> None:
    times = np.arange(0.0, 20.0, 0.5)
    given = np.array([0.0, 0.5, 1.0, 15.0, 15.5])
    table = OdometryTable(given, {"u_x": np.array([0.0, 0.0, 1.0, 3.0, 0.0])}, valid_s=np.inf)
    recording = build(Campaign(times, {"azimuth_rad": 0.1 * np.ones(40)}, table, start_pose=(0.0,) * 6))
    assert recording.odometry[1:32, 0] == pytest.approx(np.repeat([0.0, 1.0, 3.0], [2, 28, 1]))


def test_the_start_is_fitted_to_the_reference() -> None:
    times = np.arange(0.0, 60.0, 0.1)
    fixes = np.arange(0.25, 60.0, 1.0)
    heading = 0.8
    way = 2.0 * fixes[:, None] * [np.cos(heading), np.sin(heading)] + [500.0, 100.0]
    way += 0.05 * np.random.default_rng(1).standard_normal(way.shape)
    drive = OdometryTable(times, {"u_x": np.full(len(times), 2.0), "u_psi": np.zeros(len(times))})
    recording = build(Campaign(times, {"distance_m": times}, drive, reference=ReferenceTable(fixes, way)))
    assert recording.start_pose[:2] == pytest.approx([500.0, 100.0], abs=0.1)
    assert recording.start_pose[3] == pytest.approx(heading, abs=0.01)
