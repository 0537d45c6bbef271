"""Directions that are worse than expected raise their variances; others leave them as they are."""

import numpy as np
import pytest

from cellslam.slam.api import Estimate, VtEstimate
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.misfit import Misfit
from cellslam.slam.measurements.readings import Readings
from cellslam.slam.model.measurement_model import predict

POSE = np.array([5.0, -3.0, 1.8, 2.5, 0.0, 0.0])
VTS = np.array([[100.0, 40.0, 30.0], [-80.0, 150.0, 20.0], [10.0, -200.0, 25.0], [60.0, 60.0, 15.0]])
STD = np.radians(1.0)


def factor(azimuth: float, elevation: float, spread_m: float = 0.1, **options: float) -> list[float]:
    """The factors after two minutes with errors that are so many times those expected."""
    rng, misfit = np.random.default_rng(0), Misfit(MeasurementOptions(**options))
    vts = VtEstimate(np.arange(4) + 7, np.zeros(4, np.int64), VTS, np.tile(spread_m**2 * np.eye(3), (4, 1, 1)))
    answer = Estimate(POSE, np.eye(6), np.array([8, 7, 10, -1, 9]), vts=vts)
    exact = np.insert(predict(POSE, VTS)[[1, 0, 3, 2]], 3, [50.0, 1.0, 0.1], axis=0)
    variance = np.full((5, 3), STD**2)
    for _ in range(1200):
        z = exact + STD * np.array([0.0, azimuth, elevation]) * rng.standard_normal((5, 3))
        values = misfit.widened(Readings(z, variance, variance, variance, np.zeros(5), np.zeros(5)), 0.1)
        assert np.allclose(values.many[:, 0], STD**2)
        assert np.allclose(values.many[:, 1:], STD**2 * misfit.factor)
        misfit.learn(answer, values)
    return list(misfit.factor)


def test_worse_directions_are_noticed() -> None:
    """Squared errors count up to 9: twice the deviation gives 3.0 in place of 4."""
    assert factor(1.0, 1.0) == pytest.approx([1.0, 1.0], abs=0.1)
    assert factor(2.0, 1.0) == pytest.approx([3.0, 1.0], abs=0.3)
    assert factor(1.0, 2.0) == pytest.approx([1.0, 3.0], abs=0.3)
    assert factor(0.3, 0.3) == [1.0, 1.0]


def test_vts_that_are_not_known_say_nothing() -> None:
    """30 m at some 200 m are far more than a degree."""
    assert factor(3.0, 3.0, spread_m=30.0) == [1.0, 1.0]
