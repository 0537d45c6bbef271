"""Diffraction: a published worked case, continuity over shadow boundaries, geometry, which edges count."""

import numpy as np
import pytest

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.rays import prepare, trace
from cellslam.sim.rays.diffraction import fresnel_nu, knife_edge

CARRIER_HZ = 2.66e9
WAVELENGTH_M = SPEED_OF_LIGHT_MPS / CARRIER_HZ


def test_worked_case_of_rappaport():
    # T. S. Rappaport, Wireless Communications, 2nd ed., example 4.7: wavelength 1/3 m, both ends 1 km from the edge,
    # clearances 25 m, 0 and -25 m: nu = 2.74, 0, -2.74; losses 21.7 dB (numerical approximation), 6 dB, about 1 dB.
    height = np.array([25.0, 0.0, -25.0])
    excess = 2.0 * np.hypot(1000.0, height) - 2000.0
    nu = np.sign(height) * fresnel_nu(excess, 1.0 / 3.0)
    np.testing.assert_allclose(nu, [2.74, 0.0, -2.74], atol=5e-3)
    np.testing.assert_allclose(-20.0 * np.log10(np.abs(knife_edge(nu))), [21.7, 6.02, 0.74], atol=0.06)


@pytest.fixture(scope="module")
def screen(scenes):
    return prepare(scenes.city_of(scenes.rectangle((0, -40, 0), (0, 80, 0), (0, 0, 20))))


def test_the_field_is_continuous_over_the_shadow_boundary(screen):
    # A screen in x = 0, 20 m high; the transmitter at its own height sees receivers above 20 m.
    height = np.linspace(19.0, 21.0, 41) + 0.003
    receivers = np.column_stack([np.full(41, 60.0), np.zeros(41), height])
    site = np.array([-60.0, 0.0, 20.0])
    paths = trace(screen, [site], receivers, diffraction=True, carrier_hz=CARRIER_HZ)
    top = (paths.edge < 0) | (np.abs(paths.points_m[:, 0, 2] - 20.0) < 1e-9)
    straight = np.linalg.norm(receivers - site, axis=1)
    phase = np.exp(-2j * np.pi * paths.length_m / WAVELENGTH_M)
    total = np.zeros(41, np.complex128)
    np.add.at(total, paths.receiver[top], (paths.gain[:, 1, 1] * phase)[top])
    free = WAVELENGTH_M / (4 * np.pi * straight) * np.exp(-2j * np.pi * straight / WAVELENGTH_M)
    point_z = (site[2] + receivers[:, 2]) / 2
    excess = np.linalg.norm(site - [0, 0, 20]) + np.linalg.norm(receivers - [0, 0, 20], axis=1) - straight
    nu = np.sign(20.0 - point_z) * fresnel_nu(excess, WAVELENGTH_M)
    np.testing.assert_allclose(total / free, knife_edge(nu), atol=2e-3)
    assert sorted(set(paths.receiver[paths.order == 0])) == np.flatnonzero(height > 20.0).tolist()


def test_geometry_and_reciprocity(scenes):
    house = scenes.box((-5, -8, 0), (5, 8, 12))
    scene = prepare(scenes.city_of(house))
    site, receivers = np.array([-40.0, 3.0, 14.0]), np.array([[30.0, -2.0, 4.0], [6.5, -10.0, 9.0], [8.0, 0.5, 11.5]])
    there = trace(scene, [site], receivers, diffraction=True)
    back = trace(scene, receivers, [site], diffraction=True)
    bent = np.flatnonzero(there.edge >= 0)
    assert len(bent) >= 3
    edges = scene.edges
    first, last = there.points_m[bent, 0] - site, receivers[there.receiver[bent]] - there.points_m[bent, 0]
    along = edges.along[there.edge[bent]]
    cosines = [(v / np.linalg.norm(v, axis=1, keepdims=True) * along).sum(axis=1) for v in (first, last)]
    np.testing.assert_allclose(cosines[0], cosines[1], atol=1e-9)
    np.testing.assert_allclose(
        there.length_m[bent], np.linalg.norm(first, axis=1) + np.linalg.norm(last, axis=1), atol=1e-9
    )
    image = np.linalg.norm(there.vt_position_m - receivers[there.receiver], axis=1)
    np.testing.assert_allclose(image, there.length_m, atol=1e-9)
    key = np.lexsort((back.length_m, back.transmitter))
    ours = np.lexsort((there.length_m, there.receiver))
    np.testing.assert_allclose(back.length_m[key], there.length_m[ours], atol=1e-9)
    np.testing.assert_allclose(np.abs(back.gain[key]), np.abs(there.gain[ours].transpose(0, 2, 1)), atol=1e-12)


def test_which_edges_count(scenes):
    # A house has four corners and four eaves; its lower rim is none. A wall to wall neighbour of equal height takes
    # away what lies between the two.
    assert len(prepare(scenes.city_of(scenes.box((0, 0, 0), (10, 10, 8)))).edges) == 8
    row = scenes.city_of(scenes.box((0, 0, 0), (10, 10, 8)), scenes.box((10, 0, 0), (20, 10, 8)))
    edges = prepare(row).edges
    middle = edges.start + 0.5 * edges.length_m[:, None] * edges.along
    assert len(edges) == 10
    assert not np.any(np.abs(middle[:, 0]) < 1e-9)


def test_doppler_is_the_rate_of_change_of_length(scenes):
    city = scenes.city_of(scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30)))
    velocity, step = np.array([3.0, -2.0, 0.5]), 1e-4
    receiver = np.array([30.0, 0.0, 2.0])
    before, after = (trace(city, [[0.0, 0.0, 10.0]], [receiver + s * step * velocity]) for s in (-1.0, 1.0))
    rate = (after.length_m - before.length_m) / (2.0 * step)
    now = trace(city, [[0.0, 0.0, 10.0]], [receiver])
    np.testing.assert_allclose(now.doppler_hz(velocity, CARRIER_HZ), -rate / WAVELENGTH_M, rtol=1e-6)
    np.testing.assert_array_equal(now.doppler_hz(velocity, CARRIER_HZ), now.doppler_hz(velocity[None], CARRIER_HZ))
