"""Another path that merges with that of a VT: its probability, and what azimuths count for by it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from cellslam.slam.joint.new_filters import NO_ERRORS
from cellslam.slam.joint.snapshot.update_kernel import LASTS, SHIFT2, add_up, allow_for_merging, correct, expect_merging
from cellslam.slam.joint.state.layout import HITS, MERGED
from cellslam.slam.model.matrices_kernel import Sym3

POSE, VTS = np.array([3.0, -2.0, 1.5, 0.7, 0.01, -0.02]), ([80.0, 0.5, 0.2], [82.0, 0.6, 0.2], [60.0, -1.0, 0.1])
MERGE_RATE = 0.003


def prepared(one_filter: Any, **rules: float) -> Any:
    """Return a filter that knows three VTs, the first two of which the array does not resolve."""
    one = one_filter(**{"merge_rate": MERGE_RATE, **rules})
    one.put(POSE, 5.0, *VTS)
    one.f.vts.slots[:3, HITS], one.f.vts.anchor[:3, MERGED] = 5, 0.1
    return one


@pytest.mark.parametrize("e_deg", [0.0, 0.5, 1.0, 3.0, 30.0])
def test_the_probability_is_that_of_bayes(one_filter: Any, e_deg: float) -> None:
    one, e, s, q = prepared(one_filter), np.radians(e_deg), np.radians(0.4) ** 2, np.radians(0.3) ** 2
    plain, wide = norm.pdf(e, scale=np.sqrt(s)), norm.pdf(e, scale=np.sqrt(s + SHIFT2))
    density = 0.9 * plain + 0.1 * wide
    counted, lacks = allow_for_merging(one.f, 0, e, Sym3(1.0, 0.002, 0.0, s, 0.0, 1.0), q)
    share = one.f.vts.anchor[0, MERGED]
    assert share == pytest.approx(0.1 * wide / density, rel=1e-9)
    # What is expected of the VT stays; the measurement counts with the mean information of both modes.
    assert 1.0 / (counted.yy - s + q) == pytest.approx((1.0 - share) / q + share / (q + LASTS * SHIFT2), rel=1e-9)
    assert norm.logpdf(e, scale=np.sqrt(counted.yy)) + lacks == pytest.approx(np.log(density), rel=1e-9)
    assert counted[:3] == (1.0, 0.002, 0.0) and counted[4:] == (0.0, 1.0)


def test_what_nothing_says_is_forgotten(one_filter: Any) -> None:
    """0.003 begin and 0.1 end in a second: 2.9 % of the time. Of what else was known a factor of e is lost in 9.7 s."""
    one = prepared(one_filter)
    one.f.vts.anchor[:2, MERGED] = 1.0, 0.0
    expect_merging(one.f, MERGE_RATE, 1.0 / 0.103)
    np.testing.assert_allclose(
        one.f.vts.anchor[:2, MERGED] - 0.003 / 0.103, [0.100 / 0.103 / np.e, -0.003 / 0.103 / np.e]
    )
    expect_merging(one.f, MERGE_RATE, 1e4)
    np.testing.assert_allclose(one.f.vts.anchor[:3, MERGED], 0.003 / 0.103)


def turned_by(one_filter: Any, e_deg: float, **rules: float) -> float:
    """Return by how much a measurement turns the vehicle, in deg, whose azimuth differs by so much from what is
    expected."""
    one = prepared(one_filter, **rules)
    one.spread(np.diag(np.where(np.arange(one.n) == 3, np.radians(0.5), 1e-3)))
    one.f.vts.anchor[0, MERGED] = 0.03
    z, _ = one.model(0)
    q = np.array([0.3, np.radians(0.3) ** 2, 1e-3])
    z[1] += np.radians(e_deg)
    measurement = one.measurement(z, q)
    correct(one.f, NO_ERRORS, 0, one.offset, measurement, 1.0, one.rules, one.w.jacobian, one.w.pending)
    add_up(one.f, one.w.pending)
    return float(np.degrees(one.f.x[3] - POSE[3]))


def test_an_azimuth_that_jumps_turns_the_vehicle_less_and_one_that_fits_as_ever(one_filter: Any) -> None:
    for e_deg, most, least in ((0.3, 1.03, 0.97), (3.0, 0.1, 0.0)):
        never, counted = (turned_by(one_filter, e_deg, merge_rate=rate) for rate in (0.0, MERGE_RATE))
        assert least <= counted / never <= most
