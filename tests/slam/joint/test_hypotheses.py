"""Hypotheses of the associations: where two are almost as likely one Gaussian becomes two, up to so many."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from cellslam.scenarios.known_worlds.bp_slam_testbed import WORLD
from cellslam.slam.api import odometry_of, setup_of, snapshots_of
from cellslam.slam.joint.bp_slam import BpSlamOptions
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions

SNAPSHOTS = 30


@pytest.mark.parametrize("most", [1, 2, 5])
def test_there_are_as_many_gaussians_as_asked_for(most: int) -> None:
    """A room with distances alone: whether one is of an anchor or of its image is open until the vehicle has turned."""
    drive, options = WORLD.simulate(5, 0), WORLD.entries[0].options
    estimator = EkfSlam(EkfSlamOptions(**options, hypotheses=most))
    estimator.start(setup_of(drive), np.random.default_rng(0))
    numbers = []
    for odometry, snapshot in zip(odometry_of(drive)[:SNAPSHOTS], snapshots_of(drive), strict=False):
        estimate = estimator.step(1.0 if numbers else 0.0, odometry, snapshot)
        assert estimator._joint is not None
        numbers.append(len(estimator._joint))
        assert estimator._joint.shares().sum() == pytest.approx(1.0)
        assert np.linalg.eigvalsh(estimate.covariance[:2, :2]).min() > 0.0
    assert numbers[0] == 1 and max(numbers) == most


def test_a_filter_that_averages_over_associations_has_one() -> None:
    assert BpSlamOptions().hypotheses == 1
    with pytest.raises(ValidationError, match="Input should be 1"):
        BpSlamOptions.model_validate({"hypotheses": 2})
