"""What a drive says of the sizes of errors: white noise is judged apart from diffuse errors."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.slam.joint.sizes import OPTIONS, Sizes

WHITE, DIFFUSE = OPTIONS.index("noise_m"), OPTIONS.index("diffuse_m")


def sizes_of_measurements(white_share: np.ndarray, excess: np.ndarray) -> Sizes:
    """Measurements of an innovation of which white noise has a share (n,), the rest is diffuse, and whose square
    exceeds what is expected by `excess` (n,): slope and information of the variances' logarithms, by hand."""
    shares = {WHITE: white_share, DIFFUSE: 1.0 - white_share}
    slope, information, in_common = np.zeros((3, len(OPTIONS)))
    for size, share in shares.items():
        slope[size], information[size] = np.sum(share * excess), 2.0 * np.sum(share**2)
    in_common[WHITE] = 2.0 * np.sum(white_share * (1.0 - white_share))
    return Sizes(slope, information, in_common, np.full(6, np.nan), np.full(6, np.nan))


def test_less_diffuse_energy_than_told_is_no_lack_of_white_noise() -> None:
    share = np.linspace(0.02, 0.2, 100_000)
    # Diffuse errors are 0.9 times as large as assumed, too little to be said; white noise is right.
    less = sizes_of_measurements(share, (1.0 - share) * (0.9**2 - 1.0))
    slope, information = less.slopes()["noise_m"]
    assert slope / information < -0.5 and slope < -6.0 * np.sqrt(information)
    assert less.doubted() == {}


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_white_noise_that_is_not_as_told_is_doubted(factor: float) -> None:
    share = np.linspace(0.02, 0.2, 100_000)
    found = sizes_of_measurements(share, share * (factor**2 - 1.0)).doubted()
    assert list(found) == ["noise_m"] and (found["noise_m"] > 1.0) == (factor > 1.0)
