"""Every scheme of resampling."""

import numpy as np
import pytest

from cellslam.slam.model import resampling


@pytest.mark.parametrize("name", sorted(resampling.SCHEMES))
def test_resampling_is_unbiased(name):
    """Copies average to count * weight: 2000 repeats, five deviations of a multinomial."""
    rng = np.random.default_rng(3)
    weights = rng.random(20) ** 3
    weights /= weights.sum()
    copies = np.zeros(20)
    for _ in range(2000):
        ancestors = resampling.SCHEMES[name](weights, 50, rng)
        assert len(ancestors) == 50
        assert np.all(np.diff(ancestors) >= 0)
        copies += np.bincount(ancestors, minlength=20)
    assert np.all(np.abs(copies / 2000 - 50 * weights) < 5 * np.sqrt(50 * weights * (1 - weights) / 2000))
