"""Points that scatter: where they stand, what a path by way of one is, and what hides it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cellslam.sim.city.inside import OUTSIDE, enclosing
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.rays import Paths, Scene, prepare
from cellslam.sim.rays.paths import joined
from cellslam.sim.rays.scattering import (
    MEAN_DBSM,
    REACH_M,
    STAND_OFF_M,
    STD_DB,
    Scatterers,
    draw_scatterers,
    scattered_paths,
    scatterer_of,
)

CARRIER_HZ = 2.66e9
SITES = np.array([[100.0, 0.0, 30.0], [0.0, 200.0, 30.0]])


@pytest.fixture(scope="module")
def scene(scenes: SimpleNamespace) -> Scene:
    """A house of 20 m x 30 m, 12 m high."""
    scene: Scene = prepare(scenes.city_of(scenes.box((-10, -15, 0), (10, 15, 12))))
    return scene


def of(scene: Scene, places: list[list[float]], receivers: np.ndarray) -> Paths:
    return joined(
        scattered_paths(Scatterers(np.array(places), np.full(len(places), 20.0)), scene, SITES, receivers, CARRIER_HZ)
    )


def test_a_path_is_as_long_as_both_ways_and_comes_from_the_point(scene: Scene) -> None:
    place, receivers = [30.0, 60.0, 8.0], np.array([[40.0, 50.0, 1.5], [20.0, 65.0, 1.5]])
    paths, p = of(scene, [place], receivers), np.array(place)
    assert paths.receiver.tolist() == [0, 0, 1, 1] and paths.transmitter.tolist() == [0, 1, 0, 1]
    before = np.linalg.norm(p - SITES[paths.transmitter], axis=1)
    after = np.linalg.norm(p - receivers[paths.receiver], axis=1)
    np.testing.assert_allclose(paths.length_m, before + after)
    away = paths.vt_position_m - receivers[paths.receiver]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), before + after)
    np.testing.assert_allclose(away / (before + after)[:, None], (p - receivers[paths.receiver]) / after[:, None])
    # The first receiver sees it 10 m west, 10 m north and 6.5 m higher.
    assert paths.azimuth_rad[0] == pytest.approx(0.75 * np.pi)
    assert paths.elevation_rad[0] == pytest.approx(np.arctan2(6.5, np.hypot(10.0, 10.0)))
    assert paths.departure_azimuth_rad[0] == pytest.approx(np.arctan2(60.0, -70.0))
    assert (paths.order == 1).all() and (scatterer_of(paths.facets) == 0).all()
    # Bistatic radar equation: what a point of 20 m2 takes, and what of it an isotropic antenna receives.
    taken = 20.0 / (4.0 * np.pi * before**2)
    aperture = (SPEED_OF_LIGHT_MPS / CARRIER_HZ) ** 2 / (4.0 * np.pi)
    np.testing.assert_allclose(paths.gain_db, 10.0 * np.log10(taken * aperture / (4.0 * np.pi * after**2)))


def test_houses_hide_points_from_sites_and_vehicles_and_far_points_are_not_received(scene: Scene) -> None:
    east, west = [12.0, 0.0, 6.0], [-12.0, 0.0, 6.0]  # on either side of the house; site 0 stands in the east
    receivers = np.array([[40.0, 0.0, 1.5], [-40.0, 0.0, 1.5], [12.0 + REACH_M + 1.0, 0.0, 6.0]])
    paths = of(scene, [east, west], receivers)
    found = np.column_stack([paths.receiver, paths.transmitter, scatterer_of(paths.facets)]).tolist()
    assert found == [[0, 0, 0], [0, 1, 0], [1, 1, 1]]


def test_points_stand_before_walls_at_all_heights_half_of_them_at_corners(scene: Scene) -> None:
    s = draw_scatterers(scene, 400.0, np.random.default_rng(1))
    assert len(s) == pytest.approx(400, abs=80)  # 100 m of wall; Poisson
    x, y, z = np.abs(s.position_m).T
    sides = np.isclose(x, 10 + STAND_OFF_M) | np.isclose(y, 15 + STAND_OFF_M)
    assert sides.all() and (x < 10.5).all() and (y < 15.5).all()
    assert (enclosing(scene.city, s.position_m) == OUTSIDE).all()
    np.testing.assert_allclose(np.percentile(z, [0, 25, 50, 75, 100]), [0, 3, 6, 9, 12], atol=1.2)
    at_corner = np.isclose(x, 10, atol=0.31) & np.isclose(y, 15, atol=0.31)
    assert at_corner.mean() == pytest.approx(0.5, abs=0.1)
    dbsm = 10.0 * np.log10(s.cross_section_m2)
    assert dbsm.mean() == pytest.approx(MEAN_DBSM, abs=1.0) and dbsm.std() == pytest.approx(STD_DB, abs=0.7)


def test_a_point_at_a_corner_is_seen_from_both_streets(scene: Scene) -> None:
    receivers = np.array([[40.0, 0.0, 1.5], [0.0, 40.0, 1.5], [-40.0, -1.0, 1.5]])
    assert of(scene, [[10.0 + STAND_OFF_M, 15.0, 6.0]], receivers).receiver.tolist() == [0, 0, 1, 1]
