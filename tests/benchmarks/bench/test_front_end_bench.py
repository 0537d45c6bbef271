"""`cellslam bench front-end`, `calibrate`, `snapshot`: fits recover what was drawn, twins agree, bad requests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ncx2

from cellslam.benchmarks.cli.main import main
from cellslam.sim.lte.calibration.fit_constants import fit_company, fit_detection, fit_floor, structured
from cellslam.sim.lte.calibration.front_end_check import Figure, compared
from cellslam.sim.lte.calibration.overlap import Law, chances, relations
from cellslam.sim.lte.calibration.scenes import (
    Sample,
    config_of,
    draw_paths,
    measured_by_statistics,
    radio_of,
    scenes_of,
)
from cellslam.sim.lte.calibration.study import rounded
from cellslam.sim.lte.downlink.lte_waveform import LteWaveform
from cellslam.sim.lte.radio_config import NR_BANDS
from cellslam.sim.lte.single_path_bound import single_path_std
from cellslam.sim.lte.statistical.statistics import file_of, statistics

THRESHOLD = 17.0
LTE_COMMAND = "cellslam bench calibrate "


def sample(gamma_db: np.ndarray, **parts: np.ndarray) -> Sample:
    """Lone paths of given SNR, one a link, all detected without error, no clutter, unless said otherwise."""
    n = len(gamma_db)
    given = {
        "link": np.arange(n), "geometry": np.tile([300.0, 0.5, 0.2], (n, 1)), "gamma_db": gamma_db,
        "detected": np.ones(n, bool), "error": np.zeros((n, 3)), "claimed": np.ones(n), "clutter": np.empty((0, 6)),
    }  # fmt: skip
    return Sample(**(given | parts), links=n)


def test_detection_law_is_recovered() -> None:
    rng = np.random.default_rng(1)
    gamma_db = rng.uniform(5.0, 22.0, 20_000)
    chance = ncx2.sf(2.0 * THRESHOLD, 5.0, 1.8 * 10.0 ** (gamma_db / 10.0))
    law = fit_detection(sample(gamma_db, detected=rng.random(20_000) < chance), THRESHOLD)
    again = ncx2.sf(2.0 * THRESHOLD, law["dof"], law["gain"] * 10.0 ** (gamma_db / 10.0))
    assert np.abs(again - chance).max() < 0.02


def test_floors_are_recovered_from_errors_above_the_bound() -> None:
    rng, gamma_db = np.random.default_rng(2), np.full(4000, 45.0)
    calibration, diffuse = np.array([0.1, 0.004, 0.005]), np.array([1.4, 0.025, 0.017])
    bound = single_path_std(gamma_db - 44.08, 0.2)
    found = fit_floor({
        ratio: sample(gamma_db, error=rng.standard_normal((4000, 3)) * np.sqrt(
            bound**2 + calibration**2 + diffuse**2 * 10.0 ** (-ratio / 10.0)))
        for ratio in (0.0, 10.0, 20.0, 40.0)
    }, LteWaveform())  # fmt: skip
    for c, name in enumerate(("distance_m", "azimuth_rad", "elevation_rad")):
        assert found[name]["calibration"] == pytest.approx(calibration[c], rel=0.1)
        assert found[name]["diffuse_at_0_db"] == pytest.approx(diffuse[c], rel=0.05)


def test_clutter_is_counted_per_node_without_the_share_of_noise() -> None:
    rng, n = np.random.default_rng(3), 3000
    late = rng.uniform(10.0, 60.0, n)
    clutter = np.column_stack([np.arange(n), 300.0 + late, 0.5 + 0.1 * rng.standard_normal(n), np.full(n, 0.2),
                               np.full(n, -20.0), np.full(n, -1.0)])  # fmt: skip
    table = structured(sample(np.full(2 * n, 30.0), clutter=clutter), 0.2, 1750.0)
    noise = 0.2 * 195.0 / 1750.0 * 75.0 / 180.0
    assert table["mean"][5] == pytest.approx(0.5 - noise)
    assert sum(table["mean"]) == table["mean"][5]
    points = np.array(table["points"][5])
    np.testing.assert_allclose(points[:, 0], np.linspace(10.0, 60.0, len(points)), atol=3.0)
    assert points[:, 1].std() == pytest.approx(0.1, rel=0.3)
    np.testing.assert_allclose(points[:, 2:], [[0.0, -20.0]] * len(points), atol=1e-12)


def test_clutter_in_company_is_recovered() -> None:
    rng, config = np.random.default_rng(6), config_of(6.0)
    scenes = scenes_of(rng, 150, config)
    alone, double = (replace(statistics(), company=((0.0, c), (40.0, c))) for c in (1.0, 2.0))
    signal = measured_by_statistics(config, scenes, rng, double)
    assert fit_company(config, scenes, signal, alone, rng) == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize("ratio_db", [6.0, 40.0])
def test_fitted_law_of_crowded_paths_is_the_kernels(ratio_db: float) -> None:
    rng, s, repeats = np.random.default_rng(4), statistics(), 300
    config = config_of(ratio_db)
    scene = draw_paths(rng, np.array([10.0, -5.0, -12.0, -18.0, -22.0]), config)
    drawn = measured_by_statistics(config, [scene] * repeats, rng)
    law = Law(s.overlap_centre_db, s.overlap_width_db, *np.log10([s.trail, s.around, s.sidelobes]), s.sidelobe_m)
    chance = chances(
        drawn, relations(drawn, config.waveform()), ratio_db, (s.dof, s.gain), config.detection_threshold, law
    )
    for path in range(5):
        for port in range(2):
            rows = slice(5 * port + path, None, 10)
            expected = chance[rows][0]
            margin = 5.0 * np.sqrt(expected * (1.0 - expected) / repeats) + 1e-3
            assert abs(drawn.detected[rows].mean() - expected) < margin


def test_the_check_tells_a_difference_from_scatter() -> None:
    rng, config = np.random.default_rng(5), config_of(6.0)
    scenes = scenes_of(rng, 150, config)
    one, other = (measured_by_statistics(config, scenes, rng) for _ in range(2))
    alike = {f.name: f for f in compared([one], [other])}
    assert abs(alike["reported per link"].difference) < 0.08
    worse = measured_by_statistics(config_of(0.0), scenes, rng)
    assert sum(f.inside for f in compared([one], [worse])) < sum(f.inside for f in alike.values())
    assert Figure("x", 0.9, 0.94, 0.05, True, 1).inside and not Figure("x", 0.9, 1.1, 0.15, False, 1).inside


@pytest.mark.parametrize("band", ["lte", *(f"nr-{blocks}" for blocks in NR_BANDS)])
def test_constants_say_how_to_make_them_again(band: str) -> None:
    data = json.loads(file_of(band).read_text(encoding="utf-8"))
    technology, _, blocks = band.partition("-")
    command = f"cellslam bench calibrate --technology nr --resource-blocks {blocks} " if blocks else LTE_COMMAND
    assert data["provenance"]["command"].startswith(f"{command}--scenes ")
    if blocks:
        assert data["bandwidth_hz"] == radio_of(technology, int(blocks)).waveform().bandwidth_hz
    assert {"cellslam", "numpy", "scipy", "numba", "python"} <= set(data["provenance"]["versions"])
    assert len(data["provenance"]["code"]) == 16
    place = np.array(data["persistence"]["diffuse_over_place"])
    assert (place[1] > 0.85).all() and place[-1].mean() < 0.6
    assert rounded({"a": [1.234567, 3]}) == {"a": [1.2346, 3]}


def test_studies_print_their_rows(capfd: pytest.CaptureFixture[str]) -> None:
    line = ["bench", "front-end", "--runs", "2", "--seed", "3", "--quiet", "--json"]
    for study in ("single", "many", "collision", "ghosts", "motion"):
        line += ["--study", study]
    assert main(line) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [r["detected"] for r in rows["single"][2:]] == [1.0] * 6
    assert rows["many"][1]["found"] >= 9.0 and rows["collision"][2]["detected"] >= 0.8
    assert len(rows["motion"]) == 4 and np.allclose([r["rmse_over_rest"] for r in rows["motion"]], 1.0, atol=0.5)


def test_nr_is_studied_at_the_same_integrated_snr(capfd: pytest.CaptureFixture[str]) -> None:
    line = ["bench", "front-end", "--technology", "nr", "--study", "single", "--runs", "2", "--quiet", "--json"]
    assert main(line) == 0
    rows = json.loads(capfd.readouterr().out)["single"]
    assert [r["detected"] for r in rows[2:]] == [1.0] * 6
    # 3264 tones in place of 200.
    assert rows[0]["rho_db"] == pytest.approx(-32.5 - 10.0 * np.log10(3264 / 200))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("front-end", "--technology", "nr", "--study", "collision"), "ports of nr share no reference elements"),
        (("front-end", "--runs", "1"), "--runs 1"),
        (("calibrate", "--scenes", "10"), "--scenes 10"),
        (("calibrate", "--technology", "nr", "--resource-blocks", "26"), "nr is calibrated at 48, 132, 272"),
        (("calibrate", "--ratio", "50", "--check"), "--ratio 50"),
        (("calibrate", "--out", "/nowhere/x.json"), "folder does not exist"),
        (("snapshot", "tiny", "--out", "x.pdf"), ".png"),
        (("snapshot", "tiny", "--seed", "-1"), "--seed -1"),
    ],
)
def test_wrong_requests_are_one_line(words: tuple[str, ...], expected: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    err = capfd.readouterr().err
    assert expected in err and "Traceback" not in err


def test_picture_of_a_snapshot(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "one.png"
    assert main(["bench", "snapshot", "tiny", "--at", "3", "--out", str(out), "--quiet"]) == 0
    assert "true paths" in capfd.readouterr().out
    assert out.stat().st_size > 10_000
    assert main(["bench", "snapshot", "tiny", "--at", "100000", "--out", str(out)]) == 2
    assert "the drive has snapshots 0 to" in capfd.readouterr().err
