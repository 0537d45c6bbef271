"""Polarimetric path gain: free space, Fresnel reflection of slabs and half spaces, roughness.

Of a path with the legs of directions k_0, k_1, ... and of length L in all, the gain is the matrix (2, 2)

    wavelength / (4 pi L) B_r^T R_n ... R_1 B_s                                            `path_gain`
    B_s, B_r     unit vectors H and V of the direction of departure, and of that of arrival  `polarisation_basis`
    R_i          r_TE a a^T + r_TM (a x k_i) (a x k_i-1)^T, times the roughness's factor,
                 with a across k_i-1 and the normal                                        `_reflect`
    r_TE, r_TM   Fresnel's coefficients of a half space or a slab                          `reflection`

without the phase of L, which the channel adds.

Source: ITU-R P.2040-3 (materials, reflection); Ament 1953 (roughness); Friis 1946 (free space).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.city.city import Floats, Ints, Material
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

Complexes = NDArray[np.complex128]
VACUUM_PERMITTIVITY = 8.8541878188e-12


def relative_permittivity(material: Material, carrier_hz: float) -> complex:
    """Return the complex relative permittivity eta = eps_r - j sigma / (omega eps_0) (P.2040-3, eq. 9b)."""
    eps_r, sigma = material.at(carrier_hz)
    return complex(eps_r, -sigma / (2.0 * np.pi * carrier_hz * VACUUM_PERMITTIVITY))


def reflection(
    eta: ArrayLike, cos_incidence: ArrayLike, thickness_m: ArrayLike, wavelength_m: float
) -> tuple[Complexes, Complexes]:
    """Return the reflection coefficients (TE, TM) for incidence from air, (...,), broadcast, without unit.

    Half space where `thickness_m` is infinite (P.2040-3, eq. 31), else a single slab (eq. 37). The field
    vectors are e_TE and e_TE x k on both legs, so a perfect conductor has TE -1, TM +1.
    """
    eta, cos = np.asarray(eta, np.complex128), np.abs(np.asarray(cos_incidence, np.float64))
    root = np.sqrt(eta - (1.0 - cos**2))
    te, tm = (cos - root) / (cos + root), (eta * cos - root) / (eta * cos + root)
    thickness = np.asarray(thickness_m, np.float64)
    slab = np.isfinite(thickness)
    # Im(root) <= 0: the exponential decays; a wall of many skin depths is a half space.
    phase = np.exp(-4j * np.pi * np.where(slab, thickness, 0.0) / wavelength_m * root)
    te, tm = (np.where(slab, r * (1.0 - phase) / (1.0 - r**2 * phase), r) for r in (te, tm))
    return te, tm


def roughness_factor(roughness_m: ArrayLike, cos_incidence: ArrayLike, wavelength_m: float) -> Floats:
    """Return the amplitude factor exp(-8 (pi s cos i / wavelength)^2), (...,), of deviations s in m (Ament 1953)."""
    phase = np.pi * np.asarray(roughness_m, np.float64) * np.asarray(cos_incidence, np.float64) / wavelength_m
    return np.asarray(np.exp(-8.0 * phase**2), np.float64)


def polarisation_basis(direction: Floats) -> tuple[Floats, Floats]:
    """Return H (growing azimuth) and V (growing elevation), each (..., 3), unit vectors as the directions (..., 3)."""
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    flat = np.hypot(x, y)
    azimuth = np.arctan2(y, x)
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    horizontal = np.stack([-sin, cos, np.zeros_like(z)], axis=-1)
    vertical = np.stack([-z * cos, -z * sin, flat], axis=-1)
    return horizontal, vertical


def path_gain(
    corners: Floats, order: Ints, facets: Ints, normals: Floats, material: Ints, materials: Sequence[Material],
    carrier_hz: float,
) -> Complexes:  # fmt: skip
    """Return gain matrices (P, 2, 2) of paths with the corners (P, 4, 3) in m: transmitter, points, receiver.

    A path of order n uses its first n + 2 corners. `facets` (P, 2) index `normals` (F, 3) and `material` (F,).
    """
    wavelength = SPEED_OF_LIGHT_MPS / carrier_hz
    legs = np.diff(corners, axis=1)
    used = np.arange(3) <= order[:, None]
    lengths = np.where(used, np.linalg.norm(legs, axis=2), 0.0)
    k = legs[:, 0] / lengths[:, 0, None]
    field = np.stack(polarisation_basis(k), axis=2).astype(np.complex128)
    for bounce in range(2):
        rows = np.flatnonzero(order > bounce)
        if len(rows):
            facet = facets[rows, bounce]
            k_out = legs[rows, bounce + 1] / lengths[rows, bounce + 1, None]
            chosen = material[facet]
            field[rows] = _reflect(field[rows], k[rows], k_out, normals[facet], chosen, materials, carrier_hz)
            k[rows] = k_out
    receiving = np.stack(polarisation_basis(-k), axis=1)
    total = lengths.sum(axis=1)
    return np.asarray((receiving @ field) * (wavelength / (4.0 * np.pi * total))[:, None, None], np.complex128)


def _reflect(
    field: Complexes, k_in: Floats, k_out: Floats, normal: Floats, material: Ints, materials: Sequence[Material],
    carrier_hz: float,
) -> Complexes:  # fmt: skip
    """Return the field vectors (P, 3, 2) after a reflection from the direction k_in to k_out (P, 3)."""
    wavelength = SPEED_OF_LIGHT_MPS / carrier_hz
    eta = np.array([relative_permittivity(m, carrier_hz) for m in materials])[material]
    thickness = np.array([np.inf if m.thickness_m is None else m.thickness_m for m in materials])[material]
    roughness = np.array([m.roughness_m for m in materials])[material]
    cos = np.abs(np.einsum("pi,pi->p", k_in, normal))
    te, tm = reflection(eta, cos, thickness, wavelength)
    across = np.cross(k_in, normal)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    # At normal incidence every direction in the wall is "across"; take the horizontal one of the incoming
    # ray.
    across = np.where(size > 1e-9, across / np.maximum(size, 1e-9), polarisation_basis(k_in)[0])
    te_part = np.einsum("pi,pij->pj", across, field) * te[:, None]
    tm_part = np.einsum("pi,pij->pj", np.cross(across, k_in), field) * tm[:, None]
    out = across[:, :, None] * te_part[:, None] + np.cross(across, k_out)[:, :, None] * tm_part[:, None]
    return np.asarray(out * roughness_factor(roughness, cos, wavelength)[:, None, None], np.complex128)
