"""Fresnel coefficients and gain matrices against published and hand-worked values."""

import numpy as np
import pytest

from cellslam.sim.city.city import Material
from cellslam.sim.city.materials import itu_material
from cellslam.sim.errors import InputError
from cellslam.sim.rays import trace
from cellslam.sim.rays.gain import reflection, relative_permittivity, roughness_factor

CARRIER = 2.66e9
WAVELENGTH = 299_792_458.0 / CARRIER
ANGLES = np.radians([0.0, 30.0, 45.0, 60.0, 75.0])


@pytest.mark.parametrize(
    ("name", "thickness_m", "loss_db"),
    [
        ("concrete", np.inf, [8.1, 7.0, 5.8, 4.1, 2.2]),
        ("glass", 0.006, [4.2, 3.5, 2.6, 1.5, 0.5]),
        ("metal", np.inf, [0.0, 0.0, 0.0, 0.0, 0.0]),
    ],
)
def test_reflection_loss_of_vertical_polarisation_on_a_wall(name, thickness_m, loss_db):
    te, _ = reflection(relative_permittivity(itu_material(name), CARRIER), np.cos(ANGLES), thickness_m, WAVELENGTH)
    np.testing.assert_allclose(-20 * np.log10(np.abs(te)), loss_db, atol=0.051)


def test_material_table_at_the_carrier():
    eps, sigma = itu_material("concrete").at(CARRIER)
    assert (eps, sigma) == pytest.approx((5.24, 0.099), abs=5e-4)
    # sigma = 0.0462 f^0.7822 at 10 GHz, whatever the table's reference.
    assert itu_material("concrete").at(10e9)[1] == pytest.approx(0.0462 * 10**0.7822, rel=1e-12)
    with pytest.raises(InputError, match="unknown material 'conrete'; did you mean 'concrete'"):
        itu_material("conrete")


def test_slab_limits():
    eta = relative_permittivity(itu_material("concrete"), CARRIER)
    cos = np.cos(ANGLES)
    half = np.array(reflection(eta, cos, np.inf, WAVELENGTH))
    np.testing.assert_allclose(reflection(eta, cos, 5.0, WAVELENGTH), half, atol=1e-6)
    np.testing.assert_allclose(reflection(eta, cos, 0.0, WAVELENGTH), 0.0, atol=1e-15)
    # A lossless half-wave window is transparent at normal incidence.
    np.testing.assert_allclose(reflection(4.0, 1.0, WAVELENGTH / 4, WAVELENGTH), 0.0, atol=1e-12)


def test_brewster_angle_and_grazing():
    cos = np.cos(np.arctan(np.sqrt(5.0)))
    te, tm = reflection(5.0, cos, np.inf, WAVELENGTH)
    assert abs(tm) < 1e-12 < abs(te)
    np.testing.assert_allclose(reflection(5.0, 1e-9, np.inf, WAVELENGTH), [-1.0, -1.0], atol=1e-6)


def test_roughness_costs_what_is_published():
    loss_db = -20 * np.log10(roughness_factor(0.02, np.cos(np.radians([0.0, 60.0])), WAVELENGTH))
    np.testing.assert_allclose(loss_db, [21.6, 5.4], atol=0.05)


def test_line_of_sight_is_free_space(scenes):
    city = scenes.city_of(scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30)))
    paths = trace(city, [[0.0, 0.0, 10.0]], [[30.0, -40.0, 10.0]], max_order=0)
    np.testing.assert_allclose(paths.gain[0], np.diag([-1.0, 1.0]) * WAVELENGTH / (4 * np.pi * 50.0), atol=1e-15)
    assert paths.gain_db[0] == pytest.approx(-(20 * np.log10(50.0) + 20 * np.log10(2.66) + 32.4478), abs=1e-3)


def test_wall_reflection_keeps_or_turns_polarisation(scenes):
    """In a horizontal plane V is TE and H is TM; H is (-0.8, 0.6) at one end and (-0.8, -0.6) at the other,
    so a conductor, where the field along the wall vanishes, has -1 for both.
    """
    metal = Material("conductor", 1.0, 1e12)
    wall = scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30))
    tx, rx = [[0.0, 0.0, 10.0]], [[30.0, 0.0, 10.0]]
    gain = trace(scenes.city_of(wall, material=metal), tx, rx).gain[1] * (4 * np.pi * 50.0 / WAVELENGTH)
    np.testing.assert_allclose(gain, [[-1.0, 0.0], [0.0, -1.0]], atol=1e-5)
    concrete = itu_material("concrete")
    te, tm = reflection(relative_permittivity(concrete, CARRIER), 20.0 / 25.0, np.inf, WAVELENGTH)
    gain = trace(scenes.city_of(wall, material=concrete), tx, rx).gain[1] * (4 * np.pi * 50.0 / WAVELENGTH)
    np.testing.assert_allclose(gain, [[-tm, 0.0], [0.0, te]], atol=1e-9)


def test_a_tilted_conductor_rotates_polarisation_but_keeps_power(scenes):
    metal = Material("conductor", 1.0, 1e12)
    wall = scenes.rectangle((-50, 20, -60), (100, 0, 0), (0, 30, 120))
    paths = trace(scenes.city_of(wall, material=metal), [[0.0, 0.0, 10.0]], [[30.0, 0.0, -12.0]])
    gain = paths.gain[1] * 4 * np.pi * paths.length_m[1] / WAVELENGTH
    np.testing.assert_allclose(gain.conj().T @ gain, np.eye(2), atol=1e-5)
    assert abs(gain[0, 1]) > 0.05
