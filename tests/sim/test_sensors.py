"""Sensors as they are: each fault does what its key says, is declared in the truth, and touches nothing else."""

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.recording import Recording
from cellslam.sim.world import simulate


def faulty(**sets) -> Recording:
    return simulate(load("tiny", {key.replace("__", "."): value for key, value in sets.items()}).world, 3, 0)


def test_slip_is_a_factor_on_the_speed(tiny):
    r = faulty(odometry__slips_per_hour=300.0, odometry__slip_factor=1.4)
    slip = r.truth.odometry_slip
    assert set(np.unique(slip)) == {1.0, 1.4} and tiny.truth.odometry_slip is None
    np.testing.assert_array_equal(r.odometry[:, 0], tiny.odometry[:, 0] * slip)
    np.testing.assert_array_equal(r.odometry[:, 1:], tiny.odometry[:, 1:])
    np.testing.assert_array_equal(r.measurements.distance_m, tiny.measurements.distance_m)


def test_dropouts_are_nan_for_as_long_as_stated(tiny):
    r = faulty(odometry__dropouts_per_hour=300.0, odometry__dropout_s=2.0)
    gone = np.isnan(r.odometry[:, 0])
    np.testing.assert_array_equal(gone, np.isnan(r.odometry[:, 3]))
    np.testing.assert_array_equal(r.odometry[~gone], tiny.odometry[~gone])
    ends = np.flatnonzero(np.diff(np.concatenate([[0], gone, [0]])))
    lengths = 0.075 * (ends[1::2] - ends[::2])
    assert not gone[0] and len(lengths) and (lengths[:-1] > 1.9).all()


def test_the_gyro_steps_once(tiny):
    r = faulty(odometry__gyro_step_deg_per_s=0.2, odometry__gyro_step_s=12.0)
    added = r.truth.odometry_bias[:, 3] - tiny.truth.odometry_bias[:, 3]
    after = r.time_s >= 12.0
    assert abs(added[-1]) > 1e-4 and not added[~after].any()
    np.testing.assert_allclose(added[after], added[-1])
    np.testing.assert_allclose(r.odometry[:, 3] - tiny.odometry[:, 3], added, atol=1e-12)


def test_a_repeated_report_is_the_one_before(tiny):
    r = faulty(radio__repeat_probability=0.1)
    rows, own = r.rows, tiny.rows
    for t in range(1, 60):
        source = t - round(r.truth.age_s[t] / 0.075)
        np.testing.assert_array_equal(
            r.measurements.distance_m[rows[t] : rows[t + 1]],
            tiny.measurements.distance_m[own[source] : own[source + 1]],
        )
    assert (r.truth.age_s > 0.0).mean() == pytest.approx(0.1, abs=0.05)
    assert len(r.truth.measurement_vt) == len(r.measurements)


def test_a_late_snapshot_was_measured_where_the_vehicle_was(tiny):
    """Lines of sight, without errors: the distance is that of the pose so long before."""
    quiet = {"radio__noise_scale": 0.0, "radio__clock_offset_std_m": 0.0, "radio__clutter_scale": 0.0}
    r = faulty(radio__late_probability=0.3, radio__late_s=0.075, **quiet)
    late = np.flatnonzero(r.truth.age_s > 0.0)
    m, vts = r.measurements, r.truth.vts
    checked = 0
    for t in late[late > 100]:
        for row in range(r.rows[t], r.rows[t + 1]):
            vt = r.truth.measurement_vt[row]
            if vt >= 0 and vts.order[vt] == 0:
                way = np.linalg.norm(vts.position_m[vt] - r.truth.poses[t - 1, :3])
                checked += 1
                assert m.distance_m[row] == pytest.approx(way, abs=0.02)
    assert checked > 20
