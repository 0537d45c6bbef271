"""The look of figures: an estimator is known by its colour wherever it stands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.colors import to_hex

from cellslam.benchmarks.figures.style import BLACK, GREY, colour_of, estimator_styles
from cellslam.benchmarks.figures.trial.trial_figures import draw_all
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.recording import Recording
from cellslam.slam import registry

Colours = Callable[[], dict[str, set[str]]]


def test_an_estimator_has_one_colour_in_every_figure() -> None:
    names = [entry.name for entry in registry.BUILT_IN]
    own = {name: estimator_styles([name])[name] for name in names}
    assert len({line["color"] for line in own.values()} | {BLACK, GREY}) == len(names) + 2
    for shown in (names, names[::-1], names[2:5], [*names, "theirs:Own"]):
        styles = estimator_styles(shown)
        assert {name: styles[name] for name in names if name in shown} == {n: own[n] for n in names if n in shown}
    assert own["dead-reckoning"]["linestyle"] == "--"
    assert estimator_styles(["theirs:Own"])["theirs:Own"]["color"] == colour_of("theirs:Own")


def test_figures_of_a_trial_keep_to_it(
    toy_recording: Callable[..., Recording], colours: Colours, tmp_path: Path
) -> None:
    """Also where estimators stand in another order."""
    drive = toy_recording()
    names = ["dead-reckoning", "ekf-slam"]
    found = {r.name: estimate(drive, r, np.random.default_rng(0)) for r in resolve({}, names[::-1])}
    draw_all(None, drive, found, None, tmp_path)
    assert colours() == {name: {to_hex(colour_of(name))} for name in names}


def test_series_of_an_estimator_are_shades_of_its_colour() -> None:
    labels = ["ekf-slam", *(f"fastslam, particles = {count}" for count in (1, 4, 16))]
    styles = estimator_styles(labels)
    assert styles["ekf-slam"] == estimator_styles(["ekf-slam"])["ekf-slam"]
    shades = [styles[label]["color"] for label in labels[1:]]
    assert shades[0] == estimator_styles(["fastslam"])["fastslam"]["color"]
    brightness = [sum(int(shade[at : at + 2], 16) for at in (1, 3, 5)) for shade in shades]
    assert brightness == sorted(set(brightness)) and brightness[-1] < 3 * 255
    assert len({styles[label]["linestyle"] for label in labels[1:]}) == 3
