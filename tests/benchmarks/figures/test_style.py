"""The look of figures: an estimator is known by its colour wherever it stands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_hex, to_rgb
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import BLACK, GREY, colour_of, curve_styles, estimator_styles, save
from cellslam.benchmarks.figures.trial.trial_figures import draw_all
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam import registry


def test_an_estimator_has_one_colour_in_every_figure() -> None:
    names = [entry.name for entry in registry.BUILT_IN]
    own = {name: estimator_styles([name])[name] for name in names}
    assert len({line["color"] for line in own.values()} | {BLACK, GREY}) == len(names) + 2
    for shown in (names, names[::-1], names[2:5], [*names, "theirs:Own"]):
        styles = estimator_styles(shown)
        assert {name: styles[name] for name in names if name in shown} == {n: own[n] for n in names if n in shown}
    assert own["dead-reckoning"]["linestyle"] == "--"
    assert estimator_styles(["theirs:Own"])["theirs:Own"]["color"] == colour_of("theirs:Own")


def hue_deg(colour: str) -> float:
    return 360.0 * float(rgb_to_hsv(to_rgb(colour))[0])


def test_no_two_built_in_estimators_have_one_hue() -> None:
    hues = sorted(hue_deg(colour_of(entry.name)) for entry in registry.BUILT_IN)
    assert min(np.diff([*hues, hues[0] + 360.0])) > 12.0


def test_estimators_of_other_people_have_colour_and_marker_of_their_own() -> None:
    names = ["fastslam", "mine", "yours", "theirs", "ours"]
    curves = {name: np.linspace(0.0, k + 1.0, 9) for k, name in enumerate(names)}
    styles = curve_styles(curves)
    assert len({styles[name]["color"] for name in names}) == len({styles[n].get("marker") for n in names}) == 5
    assert all(styles[name]["linestyle"] not in ("-", "--") for name in names[1:])
    assert styles["mine"]["color"] == colour_of("mine")  # whatever else is drawn


def test_curves_that_coincide_are_said_to() -> None:
    one = np.array([0.0, 1.0, np.nan, 4.0])
    curves = {"fastslam": one, "ekf-slam": one + 0.01, "bp-slam": one + 0.1, "mine": one, "dead-reckoning": one[:2]}
    styles = curve_styles(curves)
    assert styles["fastslam"] == estimator_styles(["fastslam"])["fastslam"]
    assert styles["ekf-slam"]["label"] == "ekf-slam (coincides with fastslam)"
    assert styles["mine"]["label"] == "mine (coincides with fastslam)"
    assert styles["mine"]["linewidth"] > styles["ekf-slam"]["linewidth"] > 1.4  # seen on both sides of the others
    assert styles["bp-slam"]["label"] == "bp-slam" and styles["dead-reckoning"]["label"] == "dead-reckoning"


def test_figures_of_a_trial_keep_to_it(
    toy_recording: Callable[..., Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where estimators stand in another order."""
    drive, drawn = toy_recording(), list[Figure]()
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    names = ["dead-reckoning", "ekf-slam"]
    found = {r.name: estimate(drive, r, np.random.default_rng(0)) for r in resolve({}, names[::-1])}
    draw_all(None, drive, found, None, tmp_path)
    lines = [line for figure in drawn for axes in figure.axes for line in axes.lines if line.get_label() in names]
    assert {(line.get_label(), to_hex(line.get_color())) for line in lines} == {
        (n, to_hex(colour_of(n))) for n in names
    }


def test_series_of_an_estimator_are_shades_of_its_colour() -> None:
    labels = ["ekf-slam", *(f"fastslam, particles = {count}" for count in (1, 4, 16))]
    styles = estimator_styles(labels)
    assert styles["ekf-slam"] == estimator_styles(["ekf-slam"])["ekf-slam"]
    shades = [styles[label]["color"] for label in labels[1:]]
    assert shades[0] == estimator_styles(["fastslam"])["fastslam"]["color"]
    brightness = [sum(int(shade[at : at + 2], 16) for at in (1, 3, 5)) for shade in shades]
    assert brightness == sorted(set(brightness)) and brightness[-1] < 3 * 255
    assert len({styles[label]["linestyle"] for label in labels[1:]}) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a disk that is always full")
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.symlink_to("/dev/full")
    with pytest.raises(InputError, match=r"a.png: cannot be written \(No space left on device\)"):
        save(Figure(), path)
    assert not path.is_symlink()
