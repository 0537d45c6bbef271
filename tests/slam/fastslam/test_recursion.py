"""FastSLAM's recursion against the joint EKF and the exact Kalman filter; its weights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.fastslam_options import NEVER, FastSlamOptions
from cellslam.slam.fastslam.parts import likelihood
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.state.layout import one_of
from cellslam.slam.oracles import FastSlamKnownAssociation, KnownAssociation
from tests.slam import driving
from tests.slam.fastslam.drives import SHORT, WHITE, driven, street

PLANE = [0, 1, 3]


@pytest.fixture(scope="module")
def tiny() -> Recording:
    """A drive whose clock offsets are known: particles from the first snapshot on."""
    return simulate("tiny", overrides={"radio.clock_offset_std_m": 0.0})


def test_without_draws_it_is_the_joint_ekf(tiny: Recording) -> None:
    ekf, never = (driving.driven(one, tiny) for one in (EkfSlam(), FastSlam(FastSlamOptions(lag=NEVER))))
    for one, other in zip(ekf, never, strict=True):
        np.testing.assert_allclose(other.pose, one.pose, rtol=0, atol=1e-9)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-7, atol=1e-11)
        np.testing.assert_array_equal(other.association, one.association)
    assert ekf[-1].vts is not None and never[-1].vts is not None and len(ekf[-1].vts.id) > 3
    np.testing.assert_allclose(never[-1].vts.position_m, ekf[-1].vts.position_m, rtol=0, atol=1e-6)


@pytest.mark.parametrize("lag", [-1, 0, 2])
def test_many_particles_are_the_exact_kalman_filter(lag: int) -> None:
    """Eight filters of 2500 particles each, in a world that is linear over a second's drive."""
    drive = street(12, seed=1)
    exact = driven(FastSlam(FastSlamOptions(lag=NEVER, **WHITE)), drive)[-1]
    options = FastSlamOptions(particles=2500, lag=lag, block_s=0.2, **WHITE)
    found = [driven(FastSlam(options), drive, seed)[-1] for seed in range(8)]
    exact_blocks = driven(FastSlam(FastSlamOptions(lag=NEVER, block_s=0.2, **WHITE)), drive)[-1]
    means = np.array([one.pose[PLANE] for one in found])
    error, standard_error = means.mean(axis=0) - exact_blocks.pose[PLANE], means.std(axis=0, ddof=1) / np.sqrt(8)
    assert (np.abs(error) < 3.0 * standard_error).all()
    deviation = np.sqrt(np.diag(exact_blocks.covariance)[PLANE])
    assert (standard_error < 0.05 * deviation).all() and (standard_error > 0.0).all()
    mean_variance = np.mean([np.diag(one.covariance)[PLANE] for one in found], axis=0)
    np.testing.assert_allclose(mean_variance, deviation**2, rtol=0.05)
    assert np.abs(exact.pose - exact_blocks.pose).max() < 0.2


NOISY = np.array([0.3, 0.0, 0.0, 0.02, 0.0, 0.0])  # odometry so poor that particles differ


def test_weights_and_deviations() -> None:
    fastslam, unequal = FastSlam(FastSlamOptions(particles=50, lag=0, **WHITE)), 0
    setup, steps = street(80, seed=5, noise=NOISY)
    fastslam.start(setup, np.random.default_rng(0))
    for step in steps:
        fastslam.step(*step)
        assert fastslam._joint is not None
        f = one_of(fastslam._joint.arrays, 0)
        assert f.particles.weight.sum() == pytest.approx(1.0) and (f.particles.weight >= 0.0).all()
        n = int(f.size[0])
        if not fastslam._joint.blocks.track.snapshots[0, 0]:
            np.testing.assert_allclose(f.particles.deviation[:n] @ f.particles.weight, 0.0, atol=1e-9)
            assert np.linalg.eigvalsh(f.p[:n, :n]).min() > -1e-9
        unequal += f.particles.weight.max() > 2.0 / 50
    assert unequal > 10


def test_resampling_is_called_where_weights_are_unequal() -> None:
    sizes = []

    def likeliest_alone(weights: Floats, count: int, rng: np.random.Generator) -> Any:
        sizes.append(1.0 / np.sum(weights**2))
        return np.full(count, int(np.argmax(weights)))

    drive = street(80, seed=5, noise=NOISY)
    driven(FastSlam(FastSlamOptions(particles=30, lag=0, **WHITE), resampling=likeliest_alone), drive)
    assert sizes and max(sizes) < 0.5 * 30
    sizes.clear()
    driven(FastSlam(FastSlamOptions(particles=30, effective_share=0.0, **SHORT), resampling=likeliest_alone), drive)
    assert not sizes


@pytest.mark.slow
def test_one_gain_does_as_well_as_gains_of_their_own() -> None:
    """Thirty filters of one particle each have covariances of their own; together they are the classical filter."""

    class Remembering:
        total = 0.0

        def __call__(self, W: Floats) -> Floats:
            self.total += float(likelihood(W)[0])
            return likelihood(W)

    for seed in (1, 2, 3):
        drive, log_weight, poses = street(40, seed), [], []
        for particle in range(30):
            weight = Remembering()
            own = FastSlam(FastSlamOptions(particles=1, **SHORT), weight=weight)
            poses.append(driven(own, drive, particle)[-1].pose[PLANE])
            log_weight.append(weight.total)
        shares = np.exp(np.array(log_weight) - max(log_weight))
        shares /= shares.sum()
        mean = shares @ np.array(poses)
        spread = np.sqrt(shares @ (np.array(poses) - mean) ** 2)
        one = driven(FastSlam(FastSlamOptions(particles=2000, **SHORT)), drive)[-1]
        few = 1.0 / np.sum(shares**2)
        assert few > 3.0 and (np.abs(one.pose[PLANE] - mean) < 4.0 * spread / np.sqrt(few)).all()


def test_oracle_is_told_the_associations(tiny: Recording) -> None:
    ekf, found = (
        driving.driven(one(), tiny, 200, with_truth=True) for one in (KnownAssociation, FastSlamKnownAssociation)
    )
    for one, other in zip(ekf, found, strict=True):
        np.testing.assert_array_equal(one.association, other.association)
    assert np.abs(ekf[-1].pose - found[-1].pose).max() > 0.0
