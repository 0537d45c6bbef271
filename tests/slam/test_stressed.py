"""Joint filters on clocks and sensors as they are."""

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.recording import Recording
from cellslam.sim.world import simulate
from cellslam.slam.api import snapshots_of
from cellslam.slam.joint import mixture
from cellslam.slam.joint.ekf_slam import HELD, held_noise
from cellslam.slam.registry import resolve
from tests.slam.driving import driven

STRESSED = {
    "radio.clock_oscillator": "ocxo", "radio.clock_steps_per_hour": 200.0, "radio.late_probability": 0.1,
    "radio.repeat_probability": 0.05, "odometry.slips_per_hour": 200.0, "odometry.dropouts_per_hour": 200.0,
    "odometry.gyro_step_deg_per_s": 0.1,
}  # fmt: skip


@pytest.fixture(scope="module")
def stressed() -> Recording:
    return simulate(load("tiny", STRESSED).world, 3, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf-slam", "fastslam"])
def test_all_stressors_on_any_number_of_threads(stressed, monkeypatch, name):
    found = []
    for threads in (1, 2):
        monkeypatch.setattr(mixture.numba, "get_num_threads", lambda threads=threads: threads)
        found.append(np.array([answer.pose for answer in driven(resolve(name)(None), stressed)]))
    np.testing.assert_array_equal(found[0], found[1])
    error = np.linalg.norm(found[0][:, :2] - stressed.truth.poses[:, :2], axis=1)
    assert np.isfinite(found[0]).all() and error.max() < 10.0


def test_held_odometry_is_as_uncertain_as_an_unknown_acceleration():
    """Sum of density^2 dt over a gap of 2 s: (a t^2 / 2)^2."""
    held = np.arange(0.0, 2.0, 0.001)[:, None] * np.ones(6)
    variance = sum(held_noise(row) ** 2 * 0.001 for row in held)
    np.testing.assert_allclose(variance, (HELD * 2.0**2 / 2.0) ** 2, rtol=2e-3)


def test_snapshots_say_for_how_long_odometry_is_held(stressed):
    gone = np.isnan(stressed.odometry[:, 0])
    for t, snapshot in enumerate(snapshots_of(stressed)):
        assert (snapshot.odometry_held_s is not None) == gone[t]
        if gone[t]:
            last = np.flatnonzero(~gone[:t])[-1]
            assert snapshot.odometry_held_s[0] == stressed.time_s[t] - stressed.time_s[last]
            assert not snapshot.odometry_held_s[[1, 2, 4, 5]].any()
