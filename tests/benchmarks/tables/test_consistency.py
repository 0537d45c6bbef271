from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import chi2

from cellslam.benchmarks.figures.consistency_page import Shown, draw
from cellslam.benchmarks.figures.sweep.sweep_data import load
from cellslam.benchmarks.scores.map_scores import vt_nees
from cellslam.benchmarks.tables.consistency import claimed_in, consistency, nees_band
from cellslam.cli.main import main
from cellslam.sim.errors import InputError
from cellslam.slam.api import VtEstimate
from tests.benchmarks.made_up_sweeps import made_up, plan_of

TRIALS, SNAPSHOTS, SITES, VTS = 100, 41, 2, 30


def trajectory(rng: np.random.Generator, claimed: float) -> bytes:
    """A drive whose errors have unit deviation, and whose estimator claims `claimed`; one more clock is known.

    It has no columns but those of the first version.
    """
    square, known = 1.0 / claimed**2, np.zeros((SNAPSHOTS, 1))
    columns: dict[str, Any] = {
        "time_s": np.linspace(0.0, 20.0, SNAPSHOTS),
        "nees": chi2.rvs(2, size=SNAPSHOTS, random_state=rng) * square,
        "offset_error_m": np.hstack([rng.standard_normal((SNAPSHOTS, SITES)), known]),
        "offset_std_m": np.hstack([np.full((SNAPSHOTS, SITES), claimed), known]),
        "vt_nees": np.where(rng.random(VTS) < 0.1, np.nan, chi2.rvs(3, size=VTS, random_state=rng) * square),
    }
    file = io.BytesIO()
    np.savez_compressed(file, **columns)  # as in an older version, which kept less
    return file.getvalue()


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives of an honest estimator, and of one that claims too much."""
    rng, claimed = np.random.default_rng(4), {"fastslam": 1.0, "ekf-slam": 0.6}
    made = plan_of({}, tuple(claimed), TRIALS)
    out = tmp_path_factory.mktemp("swept")
    return made_up(out, made, packed=lambda _, job: trajectory(rng, claimed[job.estimator]))


def test_an_honest_estimator_lies_in_the_bands_and_one_that_claims_too_much_does_not(swept: Path) -> None:
    frame = consistency(swept, times=20)
    consistent, confident = (frame[frame["estimator"] == name] for name in ("fastslam", "ekf-slam"))
    assert list(consistent["time_s"]) == pytest.approx(np.arange(1, 21))
    assert consistent["nees"].between(consistent["nees_low"], consistent["nees_high"]).mean() >= 0.85
    assert (confident["nees"] > confident["nees_high"]).all()
    assert consistent["position_share"].mean() == pytest.approx(0.95, abs=0.02)
    assert confident["position_share"].mean() == pytest.approx(1.0 - 0.05**0.36, abs=0.03)
    assert consistent["clock_share"].between(0.91, 0.99).all()
    assert confident["clock_share"].to_numpy() == pytest.approx(0.77, abs=0.09)
    assert (consistent["clocks"] == TRIALS * SITES).all()
    last = consistent.iloc[-1]
    assert (last["vt_low"], last["vt_high"]) == pytest.approx((0.95, 0.95), abs=0.02)
    assert last["vt_low"] < last["vt_share"] < last["vt_high"]
    assert 0.85 * TRIALS * VTS < last["vts"] < 0.95 * TRIALS * VTS
    assert confident.iloc[-1]["vt_share"] < 0.6 and consistent["vt_share"].isna().sum() == 19
    assert nees_band(100) == pytest.approx((1.627, 2.411), abs=1e-3)  # means of chi-square


def test_the_page_shows_who_claims_too_much_and_over_how_many_drives(swept: Path) -> None:
    data = load(swept)
    shown = {
        one.label: Shown([claimed_in(drive) for drive in data.drives(one)], *data.over_time(one, "nees"))  # type: ignore[misc]
        for one in data.panels[0].series
    }
    figure = Figure()
    assert draw(figure, shown, "a world")
    assert figure.get_suptitle() == f"a world: {TRIALS} independent drives"
    reliability, _, _, outside = figure.axes
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in reliability.get_lines()}
    claimed = np.linspace(0.0, 1.0, 101)
    assert np.abs(lines["fastslam"] - claimed).max() < 0.04
    # q is claimed to be chi-square, and is 1 / 0.36 times that.
    assert lines["ekf-slam"] == pytest.approx(1.0 - (1.0 - claimed) ** 0.36, abs=0.04)
    assert outside.get_ylim()[0] < 0.01
    empty = Figure()
    assert not draw(empty, {}) and not empty.axes


def test_command_prints_it_and_says_where_nothing_is_kept(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["consistency", str(swept), "--times", "4", "--format", "md"]) == 0
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| fastslam")]
    assert len(table) == 4 and "1.63 to 2.41" in table[0]
    with pytest.raises(InputError, match="no trajectories"):
        consistency(made_up(tmp_path, plan_of({})))


def test_vt_nees_is_against_the_vt_that_an_estimate_stands_for(make_recording: Any) -> None:
    recording = make_recording(seed=3, snapshots=30, vts_per_site=2, ports=2, clutter=1.0)
    truth, site = recording.truth, recording.links.site
    link = np.array([np.flatnonzero(site == s)[0] for s in truth.vts.site])
    error, std = np.array([0.3, -0.2, 0.1]), np.array([0.5, 0.4, 0.3])
    covariance = np.tile(np.diag(std**2), (len(link), 1, 1))
    covariance[0] = 0.0
    vts = VtEstimate(10 + np.arange(len(link)), link, truth.vts.position_m + error, covariance)
    association = np.where(truth.measurement_vt >= 0, 10 + truth.measurement_vt, -1)
    association[truth.measurement_vt == 1] = -1
    expected = np.full(len(link), ((error / std) ** 2).sum())
    expected[:2] = np.nan
    np.testing.assert_allclose(vt_nees(recording, vts, association), expected)
