"""What is reflected from the ground besides, and pulls elevations down."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.slam.joint.new_filters import NO_ERRORS
from cellslam.slam.joint.snapshot.sight_kernel import ground
from cellslam.slam.model.measurement_kernel import Spherical

PULL_DEG = -2.713  # at 10 degrees: sin 0.17365, root of 4 + sin^2 2.00752, coefficient -0.39616, power 0.15694


@pytest.mark.parametrize(("elevation_deg", "pull_deg"), [(10.0, PULL_DEG), (-10.0, 0.0), (0.0, 0.0)])
def test_the_mean_of_a_path_and_its_reflection_from_the_ground(
    one_filter: Any, elevation_deg: float, pull_deg: float
) -> None:
    one = one_filter(NO_ERRORS._replace(ground=0.5))
    place, sight = one.f.core.ground, one.w.sight
    assert one.f.p[place, place] == 0.5**2
    one.f.x[place], sight.size[0] = 2.0, 0
    value = ground(one.f, Spherical(100.0, 0.7, np.radians(elevation_deg)), sight)
    np.testing.assert_allclose(np.degrees(value), [0.0, 0.0, 2.0 * pull_deg], atol=2e-3)
    assert sight.size[0] == (pull_deg != 0.0)
    if pull_deg:
        np.testing.assert_allclose(np.degrees(sight.by[:, 0]), [0.0, 0.0, pull_deg], atol=1e-3)
