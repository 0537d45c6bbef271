"""The start of EKF-SLAM: components of an offset; a mixture's moments, which filters it keeps."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numba import typeof

from cellslam.sim.recording.tables import CLOCK_PRIOR
from cellslam.slam.api import setup_of, snapshots_of
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.start import COMBINATIONS, Start, begin, components
from cellslam.slam.joint.state.states_kernel import differing


@pytest.fixture
def mixture() -> Mixture:
    """Three filters with random moments; the first two are likely, the third is not."""
    setup, rng = setup_of(tiny_drive()), np.random.default_rng(4)
    out = new_mixture(setup, core_of(setup, NO_ERRORS), NO_ERRORS, np.zeros((3, 2)), np.ones(2))
    size = out.core.size
    out.arrays.x[:, :size] = rng.normal(size=(3, size))
    root = rng.normal(size=(3, size, size))
    out.arrays.p[:, :size, :size] = root @ root.transpose(0, 2, 1)
    out.log_weight[:] = np.log([0.7, 0.299, 0.001]) + 5.0
    return out


def test_moments_are_those_of_the_mixture(mixture: Mixture) -> None:
    weight, size = np.array([0.7, 0.299, 0.001]), mixture.core.size
    x, p = mixture.arrays.x[:, :size], mixture.arrays.p[:, :size, :size]
    np.testing.assert_allclose(mixture.weights(), weight, rtol=1e-12)
    mean, cov = mixture.moments()
    want = weight @ x
    np.testing.assert_allclose(mean, want, rtol=1e-12)
    second = sum(w * (q + np.outer(c, c)) for w, q, c in zip(weight, p, x, strict=True))
    np.testing.assert_allclose(cov, second - np.outer(want, want), rtol=1e-9, atol=1e-12)
    x1, p1 = x[1].copy(), p[1].copy()
    mixture.keep(np.array([1]))
    assert len(mixture) == len(mixture.arrays.x) == 1
    np.testing.assert_array_equal(mixture.moments()[0], x1)
    np.testing.assert_array_equal(mixture.moments()[1], p1)


@pytest.mark.parametrize(("sites", "many"), [(1, 40), (3, 12), (8, 200)])
def test_the_likeliest_combinations_go_on_however_many_there_are(
    monkeypatch: pytest.MonkeyPatch, sites: int, many: int
) -> None:
    rng, setup = np.random.default_rng(5), setup_of(tiny_drive())
    likely = [[(float(m), float(-abs(m))) for m in rng.normal(0.0, 3.0, many)] for _ in range(sites)]
    start = begin(setup, core_of(setup, NO_ERRORS), NO_ERRORS, EkfSlamOptions())
    monkeypatch.setattr(Start, "_likely", lambda _: likely)
    found = start.combinations()
    assert found.shape == (COMBINATIONS, sites)
    log = -np.abs(found).sum(axis=1)
    assert (np.diff(log) <= 0.0).all() and len(np.unique(found, axis=0)) == COMBINATIONS
    if sites < 8:  # else there are 10^18
        every = sorted((sum(own for _, own in one) for one in product(*likely)), reverse=True)
        np.testing.assert_allclose(log, every[:COMBINATIONS])


def test_components_add_up_to_the_prior() -> None:
    means, logs, std = components(150.0, 20.0, 1.25)
    weight = np.exp(logs)
    assert std == 20.0
    assert weight.sum() == pytest.approx(1.0)
    assert np.sqrt(weight @ means**2 + std**2) == pytest.approx(150.0, rel=0.02)
    grid = np.linspace(-300, 300, 61)
    mixture = np.exp(-0.5 * ((grid[:, None] - means) / std) ** 2) @ weight / std
    np.testing.assert_allclose(mixture, np.exp(-0.5 * (grid / 150.0) ** 2) / 150.0, rtol=0.08)
    assert len(components(10.0, 20.0, 1.25)[0]) == 1


def test_blocks_of_a_mixture_end_together() -> None:
    """Or the weights of its filters, of which some have used the last snapshots and some not, were no weights."""
    drive, estimator = tiny_drive(), EkfSlam()
    estimator.start(setup_of(drive), np.random.default_rng(0))
    mixture = estimator._start.mixtures[0]
    mixture.arrays.x[::2, mixture.core.scale[0]] = 0.4  # these believe that they are slower
    dt_s = np.diff(drive.time_s, prepend=drive.time_s[0])[:120].tolist()
    lengths = set()
    for t, (dt, snapshot) in enumerate(zip(dt_s, snapshots_of(drive), strict=False)):
        estimator.step(dt, drive.odometry[t], snapshot)
        waiting = set(mixture.blocks.track.snapshots[: len(mixture), 0].tolist())
        assert len(waiting) == 1
        lengths |= waiting
    assert len(mixture) > 1
    assert max(lengths) > 2


@pytest.mark.parametrize("column", CLOCK_PRIOR[2:])
def test_kernels_take_clocks_that_are_told_more_as_they_take_others(column: str) -> None:
    """A recording's columns cannot be written; with one of them in the layout both kernels were compiled again."""
    setup = setup_of(tiny_drive())
    told = np.full(len(setup.sites), 0.1)
    told.flags.writeable = False
    more = replace(setup, sites=replace(setup.sites, **{column: told}))
    assert typeof(core_of(more, NO_ERRORS)) == typeof(core_of(setup, NO_ERRORS))


@pytest.mark.parametrize(
    ("apart", "log_odds", "both"),
    [(0.49, 0.0, False), (0.51, 0.0, True), (1.3, 6.0, False), (1.35, 6.0, True)],
    ids=["equally likely and alike", "equally likely", "unlikely and near", "unlikely"],
)
def test_the_less_likely_a_filter_is_the_more_it_must_differ(apart: float, log_odds: float, both: bool) -> None:
    """By half a deviation times the root of 1 and the log-odds: 0.5 sqrt(7) = 1.32 where these are 6."""
    x, p = np.array([[0.0, 5.0], [2.0 * apart, 5.0]]), np.tile(np.diag([4.0, 1.0]), (2, 1, 1))
    kept = differing(x, p, np.array([0.0, -log_odds]), np.array([0, 1]))
    assert kept.tolist() == ([0, 1] if both else [0])
