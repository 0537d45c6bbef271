"""Measurements of a site's links taken together: which ones, their means and variances, and the way back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.front_end.front_end_options import FrontEndOptions
from cellslam.slam.front_end.looks import BIRTH_RATIO, COINCIDENCE, UNMAPPED, UNUSUAL, Grouping, Looks, doubts
from cellslam.slam.front_end.measurement_noise import ports_of, white
from cellslam.slam.front_end.readings import readings

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
            (
                link.append(own),
                truth.append(-1),
                z.append([rng.uniform(50, 900), rng.uniform(-3, 3), rng.uniform(-0.1, 0.4)]),
            )
    return snapshot(link, z), np.array(truth)


@pytest.mark.parametrize("seed", range(20))
def test_each_path_is_one_look(seed: int) -> None:
    given, truth = many_paths(np.random.default_rng(seed), 4)
    grouping = Grouping(setup(), FrontEndOptions())
    looks = grouping.looks(given)
    z = np.stack([given.distance_m, given.azimuth_rad, given.elevation_rad], axis=1)
    apart = [np.abs(z[i] - z[j]) for i in range(len(z)) for j in range(i) if truth[i] != truth[j] or truth[i] < 0]
    if min((a / [5.0, 0.1, 0.1]).max() for a in apart) < 1.0:
        pytest.skip("two paths happen to lie together")
    for n in range(len(looks)):
        members = np.flatnonzero(looks.of == n)
        assert len(set(truth[members].tolist())) == 1
        assert (SITE[given.link[members]] == looks.link[n]).all()
        assert looks.begins[n] == (len(members) > 2)
        assert looks.ports[n] == len(set(PORT[given.link[members]].tolist()))
        assert looks.row[n] == given.row[members[0]]
    paths = {v for v in truth.tolist() if v >= 0}
    assert len(looks) == len(paths) + int((truth < 0).sum())
    assert (np.diff(looks.link) >= 0).all()


def test_ports_count_alike_and_noise_averages() -> None:
    options = FrontEndOptions()
    link = [0, 2, 4, 1]  # three of port 0, one of port 1
    z = [[100.0, 3.13, 0.1], [100.6, -3.14, 0.1], [100.3, 3.14, 0.1], [99.5, -3.13, 0.12]]
    given = snapshot(np.sort(link), [z[link.index(one)] for one in np.sort(link)])
    grouping = Grouping(setup(), options)
    looks = grouping.looks(given)
    assert len(looks) == 1
    assert looks.distance_m[0] == pytest.approx((100.3 + 99.5) / 2)
    assert looks.elevation_rad[0] == pytest.approx(0.11)
    turns = np.array([3.13, 2 * np.pi - 3.14, 3.14])
    azimuth = (turns.mean() + 2 * np.pi - 3.13) / 2
    assert np.cos(looks.azimuth_rad[0] - azimuth) == pytest.approx(1.0, abs=1e-12)
    one = white(given, options)[0]
    np.testing.assert_allclose(looks.white[0], one * (1 / 3 + 1) / 4)
    ports = ports_of(grouping.setup.links.site, grouping.setup.links.port)
    place, direction = options.persisting
    found = readings(looks, ports, options, 0.01, 0.1)
    np.testing.assert_allclose(found.single[0], looks.white[0] + place / 2 + direction)


def test_missing_components_stay_missing() -> None:
    nan = np.nan
    looks = Grouping(setup(), FrontEndOptions()).looks(
        snapshot([0, 1, 2], [[100, nan, 0.1], [100.2, 0.3, nan], [100.1, nan, nan]])
    )
    assert len(looks) == 1
    np.testing.assert_allclose([looks.distance_m[0], looks.azimuth_rad[0], looks.elevation_rad[0]], [100.125, 0.3, 0.1])
    bare = Grouping(setup(), FrontEndOptions()).looks(snapshot([0, 1], [[nan, 0.3, nan], [nan, 0.3, nan]]))
    assert np.isnan(bare.distance_m).all() and np.isnan(bare.elevation_rad).all()


def test_a_link_measures_a_path_once() -> None:
    looks = Grouping(setup(), FrontEndOptions()).looks(snapshot([0, 0, 1], [[100, 0, 0], [100.9, 0, 0], [100.8, 0, 0]]))
    assert looks.of.tolist() == [0, 1, 1]


def test_without_sharing_every_measurement_is_a_look() -> None:
    given, _ = many_paths(np.random.default_rng(0), 3)
    grouping = Grouping(setup(), FrontEndOptions(sharing="none"))
    looks = grouping.looks(given)
    assert looks.of.tolist() == list(range(len(given)))
    for name in ("link", "distance_m", "azimuth_rad", "elevation_rad", "row"):
        np.testing.assert_allclose(getattr(looks, name), getattr(given, name))
    assert looks.begins.all()
    assert grouping.options == FrontEndOptions(sharing="none")
    np.testing.assert_array_equal(grouping.setup.links.site, SITE)


def test_sites_of_one_link_are_as_without_sharing() -> None:
    lone = setup([0, 1], [0, 0])
    grouping = Grouping(lone, FrontEndOptions())
    looks = grouping.looks(snapshot([0, 0, 1], [[100, 0, 0], [300, 1, 0], [100, 0, 0]]))
    assert grouping.options == FrontEndOptions()
    assert looks.of.tolist() == [0, 1, 2] and looks.begins.all()


def test_agreement_tells_paths_from_clutter() -> None:
    doubt = doubts(np.array([6, 1, 2]), 0.88)
    by_members = doubt[0, 1:]
    assert (np.diff(by_members) < 0).all() and by_members[0] > 2 and by_members[-1] < -2
    assert (doubt[1] == 0.0).all() and (doubt[2, 3:] == 0.0).all()
    path = np.array([math.comb(6, n) * 0.88**n * 0.12 ** (6 - n) for n in range(1, 7)])
    path = (1.0 - UNUSUAL) * path / path.sum() + UNUSUAL / 6
    clutter = path * (np.exp(by_members) - UNMAPPED)
    assert clutter.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(clutter[1:] / clutter[:-1], COINCIDENCE)


def test_what_may_begin_a_vt_is_no_clutter() -> None:
    rng, grouping = np.random.default_rng(8), Grouping(setup(), FrontEndOptions())
    begins, paths = 0, 0
    for _ in range(50):
        given, truth = many_paths(rng, 4)
        looks = grouping.looks(given)
        own = truth[np.searchsorted(given.row, looks.row)]
        assert (own[looks.begins] >= 0).all()
        begins, paths = begins + looks.begins.sum(), paths + (own >= 0).sum()
    assert begins > 0.9 * paths


def test_births_are_likely_where_links_agree() -> None:
    options = FrontEndOptions(birth_ratio=0.02)
    assert Grouping(setup(), options).options.birth_ratio == BIRTH_RATIO
    assert Grouping(setup(), FrontEndOptions(birth_ratio=0.7)).options.birth_ratio == 0.7
    few = Grouping(setup([0, 0, 0, 1, 1], [0, 1, 2, 0, 1]), options)
    assert few.options.birth_ratio == 0.02
    looks = few.looks(snapshot([0, 0, 3], [[100, 0, 0], [300, 1, 0], [100, 0, 0]]))
    assert looks.begins.tolist() == [False, False, True]


def test_links_that_are_not_sorted_by_site() -> None:
    grouping = Grouping(setup([1, 0, 1, 0], [0, 0, 1, 1]), FrontEndOptions())
    looks = grouping.looks(snapshot([0, 1, 2, 3], [[100, 0, 0], [500, 1, 0], [100.1, 0, 0], [500.1, 1, 0]]))
    assert looks.link.tolist() == [0, 1]
    assert looks.of.tolist() == [1, 0, 1, 0]
    assert grouping.setup.links.site.tolist() == [0, 1]


def test_an_answer_names_measurements_and_their_links() -> None:
    grouping = Grouping(setup(), FrontEndOptions())
    looks = grouping.looks(snapshot([0, 1, 6, 7], [[100, 0, 0], [100, 0, 0], [200, 1, 0], [200, 1, 0]]))
    vts = VtEstimate(np.array([5, 9]), np.array([0, 1]), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    answer = grouping.answer(Estimate(np.zeros(6), np.eye(6), np.array([5, 9]), vts=vts), looks)
    assert answer.association is not None and answer.vts is not None
    assert answer.association.tolist() == [5, 5, 9, 9]
    assert answer.vts.link.tolist() == [0, 6]


def test_detection_and_clutter_are_those_of_looks() -> None:
    options = FrontEndOptions(detection_probability=0.5, clutter_density=1e-3)
    seen = Grouping(setup([0, 0, 1, 1], [0, 1, 0, 1]), options).options
    assert seen.detection_probability == pytest.approx(0.75)
    assert seen.clutter_density == pytest.approx(2e-3)


def test_an_empty_snapshot() -> None:
    looks = Grouping(setup(), FrontEndOptions()).looks(snapshot([], np.zeros((0, 3))))
    assert isinstance(looks, Looks) and len(looks) == 0


def test_a_receiver_without_links() -> None:
    grouping = Grouping(setup([], []), FrontEndOptions())
    assert len(grouping.looks(snapshot([], np.zeros((0, 3))))) == 0
    assert grouping.options.clutter_density == FrontEndOptions().clutter_density


def test_many_links_agree_by_the_binomial_law_too() -> None:
    n = np.arange(1, 101)
    path, clutter = stats.binom.pmf(n, 100, 0.88), COINCIDENCE ** (n - 1.0)
    path = (1.0 - UNUSUAL) * path / path.sum() + UNUSUAL / 100
    expected = np.log(clutter / clutter.sum() / path + UNMAPPED)
    np.testing.assert_allclose(doubts(np.array([100]), 0.88)[0, 1:], expected, rtol=1e-9)
