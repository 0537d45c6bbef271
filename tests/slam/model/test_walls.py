"""Walls as VTs show them: planes, their Jacobian, and where paths are reflected."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.slam.model.walls import image_in_wall, mirror_plane, reflection_point


def test_reflection_point_by_hand():
    site, vt = np.array([0.0, 0, 10]), np.array([20.0, 0, 10])
    # The wall is x = 10; from (0, 20, 10) the path meets it half-way up to the VT.
    np.testing.assert_allclose(reflection_point(site, vt, np.array([0.0, 20, 10])), [10, 10, 10])
    np.testing.assert_allclose(reflection_point(site, vt, np.array([[5.0, 6, 4]])), [[10, 4, 6]])
    # Behind the wall, and parallel to it, there is none.
    assert np.isnan(reflection_point(site, vt, np.array([[15.0, 3, 4], [20.0, 3, 4]]))).all()


def test_reflected_path_has_the_length_and_the_angles_of_a_mirror():
    rng = np.random.default_rng(3)
    for _ in range(50):
        site, vehicle, normal = rng.normal(0, 50, 3), rng.normal(0, 50, 3), rng.normal(0, 1, 3)
        normal /= np.linalg.norm(normal)
        offset = max(site @ normal, vehicle @ normal) + 10
        vt = site + 2 * (offset - site @ normal) * normal
        point = reflection_point(site, vt, vehicle)
        assert point @ normal == pytest.approx(offset)
        incoming, outgoing = point - site, vehicle - point
        length = np.linalg.norm(incoming) + np.linalg.norm(outgoing)
        assert length == pytest.approx(np.linalg.norm(vt - vehicle))
        assert incoming @ normal / np.linalg.norm(incoming) == pytest.approx(
            -outgoing @ normal / np.linalg.norm(outgoing)
        )


def test_all_sites_see_one_wall_as_the_same_plane():
    rng = np.random.default_rng(1)
    normal, about = np.array([0.6, 0.8]), rng.normal(0, 50, 2)
    sites = rng.normal(0, 50, (9, 2))
    sites -= np.maximum(sites @ normal, 0.0)[:, None] * normal  # all on one side
    vts = sites + 2 * (70.0 - sites @ normal)[:, None] * normal
    planes = mirror_plane(sites, vts, about)[0]
    np.testing.assert_allclose(planes, np.tile([np.arctan2(0.8, 0.6), 70.0 - about @ normal], (9, 1)))


def test_plane_moves_as_its_jacobian_says():
    rng = np.random.default_rng(2)
    x, about = rng.normal(0, 50, (20, 4)), rng.normal(0, 50, (20, 2))
    _, by = mirror_plane(x[:, :2], x[:, 2:], about)
    for k in range(4):
        step = 1e-5 * np.eye(4)[k]
        up, down = (mirror_plane(y[:, :2], y[:, 2:], about)[0] for y in (x + step, x - step))
        np.testing.assert_allclose((up - down) / 2e-5, by[:, :, k], atol=1e-6)


def test_the_image_of_a_site_in_a_wall_is_its_vt_and_back():
    site, vt, point = np.array([3.0, -7.0]), np.array([41.0, 22.0]), np.array([-5.0, 12.0])
    np.testing.assert_allclose(image_in_wall(site, vt, site)[0], vt)
    np.testing.assert_allclose(image_in_wall(site, vt, image_in_wall(site, vt, point)[0])[0], point)


def test_the_image_moves_as_its_jacobian_says():
    x = np.random.default_rng(4).normal(0, 50, 6)
    _, by = image_in_wall(x[:2], x[2:4], x[4:])
    for k, step in enumerate(1e-5 * np.eye(6)):
        up, down = (image_in_wall(y[:2], y[2:4], y[4:])[0] for y in (x + step, x - step))
        np.testing.assert_allclose((up - down) / 2e-5, by[:, k], atol=1e-6)
