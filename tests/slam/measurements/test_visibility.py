"""The probability that a VT is in sight, by how long it was not detected."""

import numpy as np
import pytest

from cellslam.slam.measurements.measurement_options import MeasurementOptions, existence, visibility


def test_visibility_falls_with_misses_and_comes_back_for_known_vts():
    once = visibility(0.01, 0.99, 0.0, 0.9, 50)
    known = visibility(1.0, 0.99, 0.01, 0.9, 500)
    assert np.all(np.diff(once[1:20]) < 0)
    assert once[1] == pytest.approx(0.01 * 0.99)
    assert known[2] == pytest.approx(
        (0.99 * 0.1 / (1 - 0.99 * 0.9)) * 0.99 + (1 - 0.99 * 0.1 / (1 - 0.99 * 0.9)) * 0.01
    )
    assert 0.005 < known[-1] < 0.02
    logs, age_once, age_twice = existence(MeasurementOptions(), 0.075)
    assert np.all(logs <= 0.0)
    assert 0 < age_once < age_twice
