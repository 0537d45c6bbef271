"""What is learnt is taken where it predicts better, and where links are polled in turn nothing is missed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, ttest_1samp

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings import build
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.recordings.fitting.fit_noise import unmodelled
from cellslam.recordings.fitting.fit_sizes import Learnt, in_words, learn
from cellslam.recordings.fitting.fit_tracks import polled_share
from cellslam.recordings.fitting.held_out import CHANCE, Worth, blocks_of, compared, log_densities, scores
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.recording import OdometryModel, Recording
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.sizes import Sheets
from tests.recordings.mistaken_worlds import beacons, places

NOTHING = OdometryModel(*np.zeros((4, 6)))


def test_a_difference_is_sure_as_students_test_has_it() -> None:
    rng = np.random.default_rng(3)
    for gain in (0.0, 0.2, 0.4, 0.6):
        default, other = rng.normal(0.0, 1.0, (2, 24)) + np.array([[0.0], [gain]])
        found = ttest_1samp(other - default, 0.0, alternative="greater")
        assert compared(default, other).sure == (found.pvalue < CHANCE)
    assert not compared(default[:4], default[:4] + 9.0).sure
    assert not compared(np.full(24, np.nan), default).sure


def test_a_false_alarm_is_as_rare_as_it_says() -> None:
    pairs = np.random.default_rng(4).standard_normal((2000, 2, 24))
    assert 0.03 < sum(compared(*pair).sure for pair in pairs) / len(pairs) < 0.07


def test_density_of_a_measurement_of_which_a_part_is_missing() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((3, 3, 3))
    p, h, z, noise = (
        root @ np.swapaxes(root, 1, 2),
        rng.standard_normal((3, 3)),
        np.array([0.4, np.nan, 0.1]),
        np.ones(3),
    )
    for i, log in enumerate(log_densities(z, h, p, noise)):
        known = np.ix_([0, 2], [0, 2])
        there = multivariate_normal(h[i, [0, 2]], (p[i] + np.eye(3))[known])
        assert log == pytest.approx(there.logpdf(z[[0, 2]]))


def test_blocks_are_seconds_and_minutes() -> None:
    short, long = np.arange(0.0, 60.0, 0.02), np.arange(0.0, 1500.0, 0.2)
    for time_s, least, most in ((short, 1.0, 4.5), (long, 9.0, 45.0)):
        begins = blocks_of(time_s)
        lengths = np.diff(time_s[np.minimum(begins, len(time_s) - 1)])
        assert begins[0] == 0 and begins[-1] == len(time_s)
        assert least < lengths.min() and lengths.max() < most


def test_right_sizes_predict_better_than_wrong_ones() -> None:
    """Odometry of a yaw rate that errs by 0.4 rad/s is not what a filter that takes it for exact predicts."""
    recording = build(places(7))
    sheet = recording.odometry_model
    density, options = sheet.noise_density.copy(), EkfSlamOptions(**unmodelled(recording))
    wrong = replace(sheet, noise_density=density * np.array([1.0, 1.0, 1.0, 100.0, 1.0, 1.0]))
    right, loose = (scores(recording, Sheets(options, one), [options]) for one in (sheet, wrong))
    assert compared(loose, right).sure and not compared(right, right).sure


def test_what_is_not_surely_better_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit that found odometry to be a hundred times worse than it is."""
    recording = build(places(7))
    sheet = recording.odometry_model
    bad = Learnt(unmodelled(recording), replace(sheet, noise_density=100.0 * sheet.noise_density), {}, None)
    monkeypatch.setattr("cellslam.recordings.fitting.fit_sizes._fitted", lambda *_: bad)
    learnt = learn(recording, None)
    assert learnt.odometry_model is sheet and learnt.options == unmodelled(recording)
    assert in_words(learnt)[0].startswith("kept the defaults: what was learnt does not surely predict better")


def test_the_worth_of_the_best_is_reported_where_the_defaults_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the odometry, too, four of eight parts are predicted better, by measurements alone all a little worse."""
    recording = build(places(7))
    learnt = Learnt(unmodelled(recording), recording.odometry_model, {}, None)
    found = iter([np.zeros(8), np.linspace(-0.2, -0.1, 8), np.array([-1.0, 1.5] * 4)])
    monkeypatch.setattr("cellslam.recordings.fitting.fit_sizes._fitted", lambda *_: learnt)
    monkeypatch.setattr("cellslam.recordings.fitting.fit_sizes.scores", lambda *_: next(found))
    worth = learn(recording, None).worth
    assert worth is not None and not worth.sure and worth.mean == pytest.approx(0.25)


def test_progress_ends_where_it_was_said_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a drive whose first pass fits, and of commands that the vehicle follows at once."""
    recording = build(places(7))
    commanded = replace(recording, odometry_model=replace(recording.odometry_model, time_constant_s=0.0))
    found: Any = SimpleNamespace(deviations=dict, bias=np.zeros(6), scale=np.zeros(6))
    fit = "cellslam.recordings.fitting.fit_sizes"
    monkeypatch.setattr(f"{fit}._found", lambda *_: found)
    monkeypatch.setattr(f"{fit}.stepped", lambda tried, *_: (tried, 0.0))
    monkeypatch.setattr(f"{fit}.scores", lambda *_: np.zeros(8))
    left: list[int] = []

    @contextmanager
    def progress(_: str, total: int) -> Iterator[Callable[[int], None]]:
        done = list[int]()
        yield done.append
        left.append(total - sum(done))

    for one in (recording, commanded):
        learn(one, None, progress)
    assert left == [0] * 5


def test_what_was_learnt_is_reported_with_its_worth() -> None:
    changes = {"noise_m": (2.0, 0.1), "u_x": (1.1, 0.1)}
    lines = in_words(Learnt({}, NOTHING, changes, Worth(1.5, 0.2, 24)))
    assert "worth 1.5 +- 0.2 nats" in lines[0] and lines[1:] == [
        "  white noise of distance: 2 times as large as assumed (+- 10 %)"
    ]


@pytest.mark.parametrize("links", [1, 4])
def test_links_that_are_polled_in_turn_are_noticed(links: int) -> None:
    campaign = beacons(1)
    link = np.arange(len(np.asarray(campaign.link))) % links
    recording = build(replace(campaign, link=link, link_sites="abcd"[:links]))
    assert polled_share(recording) == pytest.approx(1.0 / links, rel=0.01)


def test_a_link_that_is_missed_or_hidden_for_a_while_is_not_taken_for_polled(take: Callable[..., Recording]) -> None:
    recording = build(replace(beacons(1), link=None, link_sites=("a",), snapshots_s=np.asarray(beacons(1).time_s)))
    rows = np.random.default_rng(2).random(len(recording.measurements)) < 0.9
    rows[500:900] = False
    assert polled_share(take(recording, rows)) > 0.97


@pytest.mark.slow
def test_polled_beacons_are_not_missed_without_learning() -> None:
    """Four beacons, each observed in every fourth snapshot: ranges hold the drive that odometry alone loses."""
    recording = build(beacons(3))
    names = ("ekf-slam", "dead-reckoning")
    given: Any = assumed(recording, Origin.of(recording), names, {}, fit=False)
    own, alone = (
        score(recording, estimate(recording, request, np.random.default_rng(0)), None)["position_rmse_m"]
        for request in given.requests
    )
    assert own < 0.3 * alone
