"""P <- P - G^T G in blocks of four, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.slam.model.arrays_kernel import downdate


@pytest.mark.parametrize("size", [1, 3, 4, 7, 30])
@pytest.mark.parametrize("gains", [0, 1, 4, 6, 11])
def test_downdate_is_minus_the_product_of_the_gains(size: int, gains: int) -> None:
    rng = np.random.default_rng(size)
    g, p = rng.normal(size=(gains + 3, size + 2)), rng.normal(size=(size + 2, size + 2))
    p = p + p.T
    want = p.copy()
    want[:size, :size] -= g[:gains, :size].T @ g[:gains, :size]
    downdate(p, size, g, gains)
    np.testing.assert_allclose(p, want, rtol=1e-12, atol=1e-12)
