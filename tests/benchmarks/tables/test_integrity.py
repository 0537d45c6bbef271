"""Protection levels over the drives of a sweep, and overbounds that are fitted on some and tested on others."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.sweep.stanford_diagram import draw_stanford
from cellslam.benchmarks.figures.sweep.sweep_data import load
from cellslam.benchmarks.scores.belief import Claim
from cellslam.benchmarks.scores.statistics import share_interval, upper_limit
from cellslam.benchmarks.sweeps.trajectories import SHAPES, Trajectory, pack
from cellslam.benchmarks.tables.integrity import Overbound, Question, fit_overbound, fitted, integrity, regions
from cellslam.cli.main import main
from cellslam.sim.errors import InputError
from tests.benchmarks.made_up_sweeps import made_up, plan_of

DRIVES, SNAPSHOTS = 12, 400


def trajectory(rng: np.random.Generator, claimed_m: float) -> bytes:
    """A drive whose errors, of Student's t, have the scale of one metre, while `claimed_m` is claimed."""
    error = rng.standard_normal((SNAPSHOTS, 2)) / np.sqrt(rng.chisquare(5.0, (SNAPSHOTS, 1)) / 5.0)
    columns: dict[str, Any] = dict.fromkeys(SHAPES, np.zeros(0, np.float32)) | {
        "time_s": np.arange(float(SNAPSHOTS)), "poses": np.zeros((SNAPSHOTS, 6)), "horizontal_m": error,
        "covariance_m2": np.tile([claimed_m**2, 0.0, claimed_m**2], (SNAPSHOTS, 1)),
        "nees": (error**2).sum(axis=1) / claimed_m**2, "heading_error_rad": np.zeros(SNAPSHOTS),
        "heading_std_rad": np.ones(SNAPSHOTS),
    }  # fmt: skip
    return pack(Trajectory(**columns))


def swept(out: Path, seed: int) -> Path:
    rng, claimed = np.random.default_rng(seed), {"bold": 0.5, "honest": 1.0, "timid": 2.0}
    made = plan_of({}, ("ekf-slam", "fastslam", "bp-slam"), DRIVES)
    of = dict(zip(("ekf-slam", "fastslam", "bp-slam"), claimed.values(), strict=True))
    return made_up(
        out,
        made,
        lambda task, _: {"seed": seed, "trial": task.trial},
        lambda _, job: trajectory(rng, of[job.estimator]),
    )


@pytest.mark.parametrize(("count", "events"), [(24, 0), (20, 3), (1, 0)])
def test_upper_limit_of_zeros_and_ones_is_that_of_clopper_and_pearson(count: int, events: int) -> None:
    from scipy.stats import beta

    shares = np.array([1.0] * events + [0.0] * (count - events))
    expected = beta.ppf(0.95, events + 1, count - events)
    assert upper_limit(shares, 0.95) == pytest.approx(expected, abs=0.01)


def test_upper_limit_is_above_the_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    for a, b in ((0.05, 1.0), (2.0, 5.0)):
        held = [upper_limit(rng.beta(a, b, 10), 0.9) >= a / (a + b) for _ in range(150)]
        assert np.mean(held) >= 0.85
    low, high = share_interval(rng.beta(2.0, 5.0, 40), 0.95)
    assert 0.0 <= low < 2.0 / 7.0 < high <= 1.0 and math.isnan(upper_limit(np.zeros(0), 0.95))
    assert math.isnan(share_interval(np.zeros(4), 0.95)[0])


def test_regions_by_worked_numbers() -> None:
    error, level = np.array([1.0, 2.5, 4.0, 1.0, 9.0]), np.array([2.0, 2.0, 2.0, 5.0, 5.0])
    assert regions(error, level, 3.0) == pytest.approx(dict.fromkeys(regions(error, level, 3.0), 0.2))


def test_an_overbound_holds_all_that_it_was_fitted_on_and_finds_the_tail() -> None:
    rng = np.random.default_rng(4)
    gaussian = [4.0 * rng.chisquare(2, 2000) for _ in range(10)]
    found = fitted(gaussian, 1e-3)
    assert 2.0 <= found.scale < 2.5 and found.freedom >= 10.0
    heavy = [rng.chisquare(2, 2000) / (rng.chisquare(3.0, 2000) / 3.0) for _ in range(10)]
    tail = fitted(heavy, 1e-3)
    assert tail.freedom <= 5.0
    for claim, drives in ((found, gaussian), (tail, heavy)):
        q = np.sort(np.concatenate(drives))
        reached = 1.0 - np.arange(len(q)) / len(q)
        upper = reached <= 0.5
        assert (claim.beyond(q[upper]) >= reached[upper] - 1e-9).all()
    assert fitted([0.25 * one for one in gaussian], 1e-3).scale == pytest.approx(found.scale / 2.0)


@pytest.mark.slow
def test_who_claims_too_much_misleads_until_it_is_overbounded(tmp_path: Path) -> None:
    training, tested = swept(tmp_path / "a", 1), swept(tmp_path / "b", 2)
    question = Question(1e-3, (3.0, 30.0))
    raw = integrity(tested, question, rows=("estimator",)).set_index(["estimator", "alert_limit_m"])
    assert (raw["drives"] == DRIVES).all() and set(raw["claims"]) == {"as claimed"}
    bold, honest, timid = (raw.loc[(name, 3.0)] for name in ("ekf-slam", "fastslam", "bp-slam"))
    assert bold["misleading"] > 0.05 > honest["misleading"] > timid["misleading"]
    assert bold["hazardous"] > 0.01 and bold["hazardous"] < bold["hazardous_high"]
    assert honest["availability"] == timid["availability"] == 0.0 and bold["availability"] == 1.0
    assert raw.loc[("bp-slam", 30.0)]["misleading_high"] == pytest.approx(1.0 - 0.05 ** (1 / DRIVES), abs=0.02)

    overbound = fit_overbound(training)
    assert overbound.drives == DRIVES and overbound.seeds == (1,)
    scales = [overbound.claims[name].scale for name in ("ekf-slam", "fastslam", "bp-slam")]
    assert scales[0] > scales[1] > scales[2]
    both = integrity(tested, question, overbound, ("estimator",))
    wide = both[both["claims"] == "overbound"].set_index(["estimator", "alert_limit_m"])
    assert (wide["misleading"] <= 1e-3).all() and (wide["served_m"] < 16.0).all()
    with pytest.raises(InputError, match="seed 1"):
        integrity(training, question, overbound, ("estimator",))


def test_rows_of_one_drive_are_one_drive(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    made = plan_of({"grid": {"radio.load": [0.01, 1.0]}}, ("ekf-slam",), 6)
    made_up(tmp_path, made, lambda task, _: {"trial": task.trial}, lambda *_: trajectory(rng, 1.0))
    assert set(integrity(tmp_path, rows=("estimator",))["drives"]) == {6}


def test_commands_and_their_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    training, tested, file = swept(tmp_path / "a", 1), swept(tmp_path / "b", 2), tmp_path / "overbound.json"
    assert main(["fit-overbound", str(training), "--out", str(file)]) == 0
    assert "12 drives" in capsys.readouterr().err
    arguments = ["integrity", str(tested), "--overbound", str(file), "--format", "csv", "--alert-limit", "10"]
    assert main(arguments) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 2 * 3
    assert main(["integrity", str(tested), "--direction", "along", "--risk", "0.01"]) == 0
    assert "upper 95 % limits over independent drives" in capsys.readouterr().out
    for text in ("{", json.dumps({"estimators": {"a": {"scale": -1, "freedom": None}}, "seeds": [], "drives": 1})):
        file.write_text(text, "utf-8")
        with pytest.raises(InputError, match="not a file of fit-overbound"):
            Overbound.load(file)
    for wrong in (["--risk", "2"], ["--alert-limit", "-1"]):
        assert main(["integrity", str(tested), *wrong]) == 2


def test_stanford_diagram_of_each_estimator(tmp_path: Path) -> None:
    figure = Figure()
    assert draw_stanford(figure, load(swept(tmp_path, 3)))
    assert [axes.get_title() for axes in figure.axes] == ["bp-slam", "ekf-slam", "fastslam"]


def test_trajectories_of_older_versions_say_what_they_lack(tmp_path: Path) -> None:
    from io import BytesIO

    file = BytesIO()
    np.savez_compressed(file, **{name: np.ones(3) for name in ("time_s", "error_m", "nees", "std_m")})
    made_up(tmp_path, plan_of({}), packed=lambda *_: file.getvalue())
    for wrong in (integrity, fit_overbound):
        with pytest.raises(InputError, match="sweep again"):
            wrong(tmp_path)
    assert not draw_stanford(Figure(), load(tmp_path))


def test_claims_are_read_as_they_are_without_an_overbound() -> None:
    assert Claim().beyond(np.array([0.0, 2.0])) == pytest.approx([1.0, math.exp(-1.0)])
