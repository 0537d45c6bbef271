"""Measurements of a site's links taken together: which ones, their means and variances, and the way back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.measurements.fusion import (
    COINCIDENCE,
    UNMAPPED,
    UNUSUAL,
    FusedMeasurements,
    Fusion,
    clutter_log_ratios,
    white,
)
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings import ports_of, readings

SITE = np.repeat([0, 1], 6)
PORT = np.tile([0, 1], 6)
SNR_DB = 12.0


def setup(site: Any = SITE, port: Any = PORT) -> Setup:
    sheet = OdometryModel(np.full(6, 0.01), np.zeros(6), np.zeros(6), np.zeros(6))
    links = Links(np.array(site), np.arange(len(site)), np.array(port))
    sites = Sites(("A", "B"), np.zeros(2), np.full(2, 150.0))
    return Setup(links, sites, sheet, np.zeros(6), np.zeros(6))


def snapshot(link: Any, z: Any) -> Snapshot:
    link, z = np.array(link, np.int64), np.array(z, float).reshape(-1, 3)
    columns = [np.array(c) for c in (link, *z.T, np.full(len(link), SNR_DB))]
    for column in columns:
        column.setflags(write=False)
    return Snapshot(7, 100 + np.arange(len(link)), *columns)


def fused(link: Any, z: Any) -> FusedMeasurements:
    return Fusion(setup(), MeasurementOptions()).fuse(snapshot(link, z))


def many_paths(rng: np.random.Generator, paths: int) -> tuple[Snapshot, Any]:
    """Return a snapshot of both sites' paths, most links seeing most of them, with clutter; and the truth (m,)."""
    where = np.stack(
        [rng.uniform(50, 900, 2 * paths), rng.uniform(-3, 3, 2 * paths), rng.uniform(-0.1, 0.4, 2 * paths)], 1
    )
    link, z, truth = [], [], []
    for own in range(12):
        rows = [v for v in range(2 * paths) if v % 2 == SITE[own] and rng.random() < 0.85]
        rng.shuffle(rows)
        for v in rows:
            link.append(own), truth.append(v), z.append(where[v] + rng.normal(size=3) * [0.3, 0.008, 0.008])
        if rng.random() < 0.5:
            link.append(own), truth.append(-1)
            z.append([rng.uniform(50, 900), rng.uniform(-3, 3), rng.uniform(-0.1, 0.4)])
    return snapshot(link, z), np.array(truth)


@pytest.mark.parametrize("seed", range(5))
def test_each_path_is_one_fused_measurement(seed: int) -> None:
    given, truth = many_paths(np.random.default_rng(seed), 4)
    fusion = Fusion(setup(), MeasurementOptions())
    measurements = fusion.fuse(given)
    z = np.stack([given.distance_m, given.azimuth_rad, given.elevation_rad], axis=1)
    apart = [np.abs(z[i] - z[j]) for i in range(len(z)) for j in range(i) if truth[i] != truth[j] or truth[i] < 0]
    if min((a / [5.0, 0.1, 0.1]).max() for a in apart) < 1.0:
        pytest.skip("two paths happen to lie together")
    for n in range(len(measurements)):
        members = np.flatnonzero(measurements.of == n)
        assert len(set(truth[members].tolist())) == 1
        assert (SITE[given.link[members]] == measurements.link[n]).all()
        assert measurements.begins[n] == (len(members) > 2)
        assert measurements.ports[n] == len(set(PORT[given.link[members]].tolist()))
        assert measurements.row[n] == given.row[members[0]]
    paths = {v for v in truth.tolist() if v >= 0}
    assert len(measurements) == len(paths) + int((truth < 0).sum())
    assert (np.diff(measurements.link) >= 0).all()


def test_ports_count_alike_and_noise_averages() -> None:
    options = MeasurementOptions()
    link = [0, 2, 4, 1]  # three of port 0, one of port 1
    z = [[100.0, 3.13, 0.1], [100.6, -3.14, 0.1], [100.3, 3.14, 0.1], [99.5, -3.13, 0.12]]
    given = snapshot(np.sort(link), [z[link.index(one)] for one in np.sort(link)])
    fusion = Fusion(setup(), options)
    measurements = fusion.fuse(given)
    assert len(measurements) == 1
    assert measurements.distance_m[0] == pytest.approx((100.3 + 99.5) / 2)
    assert measurements.elevation_rad[0] == pytest.approx(0.11)
    turns = np.array([3.13, 2 * np.pi - 3.14, 3.14])
    azimuth = (turns.mean() + 2 * np.pi - 3.13) / 2
    assert np.cos(measurements.azimuth_rad[0] - azimuth) == pytest.approx(1.0, abs=1e-12)
    one = white(given, options)[0]
    np.testing.assert_allclose(measurements.white[0], one * (1 / 3 + 1) / 4)
    ports = ports_of(fusion.setup.links.site, fusion.setup.links.port)
    place, direction = options.persisting
    found = readings(measurements, ports, options, 0.01, 0.1)
    np.testing.assert_allclose(found.single[0], measurements.white[0] + place / 2 + direction)


def test_missing_components_stay_missing() -> None:
    nan = np.nan
    measurements = fused([0, 1, 2], [[100, nan, 0.1], [100.2, 0.3, nan], [100.1, nan, nan]])
    assert len(measurements) == 1
    np.testing.assert_allclose(
        [measurements.distance_m[0], measurements.azimuth_rad[0], measurements.elevation_rad[0]], [100.125, 0.3, 0.1]
    )
    bare = fused([0, 1], [[nan, 0.3, nan], [nan, 0.3, nan]])
    assert np.isnan(bare.distance_m).all() and np.isnan(bare.elevation_rad).all()


def test_a_link_measures_a_path_once() -> None:
    assert fused([0, 0, 1], [[100, 0, 0], [100.9, 0, 0], [100.8, 0, 0]]).of.tolist() == [0, 1, 1]


def test_without_sharing_no_measurement_is_fused() -> None:
    given, _ = many_paths(np.random.default_rng(0), 3)
    fusion = Fusion(setup(), MeasurementOptions(sharing="none"))
    measurements = fusion.fuse(given)
    assert measurements.of.tolist() == list(range(len(given)))
    for name in ("link", "distance_m", "azimuth_rad", "elevation_rad", "row"):
        np.testing.assert_allclose(getattr(measurements, name), getattr(given, name))
    assert measurements.begins.all()
    assert fusion.options == MeasurementOptions(sharing="none")
    np.testing.assert_array_equal(fusion.setup.links.site, SITE)


def test_agreement_tells_paths_from_clutter() -> None:
    clutter_log_ratio = clutter_log_ratios(np.array([6, 1, 2]), 0.88)
    by_members = clutter_log_ratio[0, 1:]
    assert (np.diff(by_members) < 0).all() and by_members[0] > 2 and by_members[-1] < -2
    assert (clutter_log_ratio[1] == 0.0).all() and (clutter_log_ratio[2, 3:] == 0.0).all()
    path = np.array([math.comb(6, n) * 0.88**n * 0.12 ** (6 - n) for n in range(1, 7)])
    path = (1.0 - UNUSUAL) * path / path.sum() + UNUSUAL / 6
    clutter = path * (np.exp(by_members) - UNMAPPED)
    assert clutter.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(clutter[1:] / clutter[:-1], COINCIDENCE)


def test_links_that_are_not_sorted_by_site() -> None:
    fusion = Fusion(setup([1, 0, 1, 0], [0, 0, 1, 1]), MeasurementOptions())
    measurements = fusion.fuse(snapshot([0, 1, 2, 3], [[100, 0, 0], [500, 1, 0], [100.1, 0, 0], [500.1, 1, 0]]))
    assert measurements.link.tolist() == [0, 1]
    assert measurements.of.tolist() == [1, 0, 1, 0]
    assert fusion.setup.links.site.tolist() == [0, 1]


def test_an_answer_names_measurements_and_their_links() -> None:
    fusion = Fusion(setup(), MeasurementOptions())
    measurements = fusion.fuse(snapshot([0, 1, 6, 7], [[100, 0, 0], [100, 0, 0], [200, 1, 0], [200, 1, 0]]))
    vts = VtEstimate(np.array([5, 9]), np.array([0, 1]), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    answer = fusion.answer(Estimate(np.zeros(6), np.eye(6), np.array([5, 9]), vts=vts), measurements)
    assert answer.association is not None and answer.vts is not None
    assert answer.association.tolist() == [5, 5, 9, 9]
    assert answer.vts.link.tolist() == [0, 6]
