"""Single diffraction at building edges: Fresnel's half-plane, phase included.

For a transmitter s, a receiver r, and an edge that starts at a and runs along the unit vector e:

    point        p = a + t e, where both legs make the same angle with e         `diffraction_kernel.diffractions`
    excess       d = |s - p| + |p - r| - |s - r|,   nu = 2 sqrt(d / wavelength)  `fresnel_nu`; at most LARGEST_NU
    field        F = (1 + j) / 2 int_nu^inf exp(-j pi t^2 / 2) dt                `knife_edge`
    gain         wavelength / (4 pi |s - r|) F exp(2j pi d / wavelength), in the shadow of the wedge; beside it
                 with the sign reversed                                          `diffraction_gain`, `in_shadow`
    free         no triangle between r and p, nor between s and p                `diffracted_paths`

Source: ITU-R P.526-15, section 4.1; directions and polarisation, Keller, "Geometrical theory of diffraction", 1962.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.rays.diffracting_edges import Edges
from cellslam.sim.rays.first_order import BLOCKS
from cellslam.sim.rays.gain import Complexes, polarisation_basis
from cellslam.sim.rays.paths import Found
from cellslam.sim.rays.scene import Scene

LARGEST_NU = 7.0
"""Edges that would add more than 30 dB to free space are left out."""
EDGE_CLEARANCE_M = 0.01


def fresnel_nu(excess_m: ArrayLike, wavelength_m: float) -> Floats:
    """Return nu = 2 sqrt(excess length / wavelength), (...,) without unit, of lengths in m (P.526-15, equation 29)."""
    return np.asarray(2.0 * np.sqrt(np.maximum(excess_m, 0.0) / wavelength_m), np.float64)


def knife_edge(nu: ArrayLike) -> Complexes:
    """Return the field (...,) behind a half-plane relative to free space (P.526-15, equation 30: J = -20 log10 |F| dB).

    F = (1 + j)/2 times the integral of exp(-j pi t^2 / 2) from nu on; 1/2 at grazing incidence.
    """
    from scipy.special import fresnel

    s, c = fresnel(np.asarray(nu, np.float64))
    return np.asarray(0.5 * (1.0 + 1j) * ((0.5 - c) - 1j * (0.5 - s)), np.complex128)


def diffracted_paths(scene: Scene, transmitter: Floats, receivers: Floats, wavelength_m: float) -> Found:
    """Return all free paths over one edge to receivers (R, 3), centred coordinates in m."""
    from cellslam.sim.rays.diffraction_kernel import diffractions

    edges = scene.edges
    most = LARGEST_NU**2 * wavelength_m / 4.0
    room = 64 * len(receivers) + 1024
    while True:
        pair, position = np.empty((room, 2), np.int64), np.empty(room)
        found = diffractions(
            edges.start, edges.along, edges.length_m, edges.into, transmitter, receivers, most, BLOCKS, pair, position
        )
        if found <= room:
            break
        room = found
    row, edge = pair[:found].T
    point = edges.start[edge] + position[:found, None] * edges.along[edge]
    rows = np.arange(found)
    for ends in (receivers[row], np.broadcast_to(transmitter, (found, 3))):
        distance = np.linalg.norm(point[rows] - ends[rows], axis=1)
        reach = np.maximum(1.0 - (EDGE_CLEARANCE_M + scene.clearance_m.min()) / np.maximum(distance, 1e-9), 0.0)
        rows = rows[scene.unobstructed(ends[rows], point[rows], reach)]
    return Found.of(row[rows], points=point[rows, None], edge=edge[rows])


def in_shadow(edges: Edges, edge: Ints, transmitter: Floats, receiver: Floats) -> NDArray[np.bool_]:
    """Tell per path (P,) whether the edge's wedge, or its only facet, stands between its ends (P, 3), in m."""
    origin, along = edges.start[edge], edges.along[edge]
    t, r = (_across(end - origin, along) for end in (transmitter, receiver))
    dt, dr = (np.linalg.norm(v, axis=1, keepdims=True) for v in (t, r))
    # Where the straight line passes the edge, seen along the edge; a facet on that side blocks it.
    nearest = (t * dr + r * dt) / np.maximum(dt + dr, 1e-12)
    one, two = edges.into[edge, 0], edges.into[edge, 1]
    towards = np.where(np.isnan(two), one, one + two)
    return np.asarray(np.einsum("pi,pi->p", nearest, towards) > 0.0, np.bool_)


def diffraction_gain(
    edges: Edges, edge: Ints, transmitter: Floats, point: Floats, receiver: Floats, wavelength_m: float
) -> Complexes:
    """Return gain matrices (P, 2, 2), as `gain.path_gain` does, of paths over edges; all ends (P, 3) in m.

    The half-plane treats both polarisations alike; they follow the edge-fixed vectors of geometrical diffraction
    (Keller 1962). Beside the wedge's shadow the sign is reversed: then it is what the edge takes from the line of
    sight. The phase of the path's own length is left out.
    """
    first, second = point - transmitter, receiver - point
    lengths = np.linalg.norm(first, axis=1) + np.linalg.norm(second, axis=1)
    straight = np.linalg.norm(receiver - transmitter, axis=1)
    k_in, k_out = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (first, second))
    excess = np.maximum(lengths - straight, 0.0)
    factor = knife_edge(fresnel_nu(excess, wavelength_m)) * np.exp(2j * np.pi * excess / wavelength_m)
    factor = np.where(in_shadow(edges, edge, transmitter, receiver), factor, -factor)
    field = np.stack(polarisation_basis(k_in), axis=2)
    out = np.zeros_like(field)
    along = edges.along[edge]
    before, after = (np.cross(along, k) for k in (k_in, k_out))
    before, after = (v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9) for v in (before, after))
    for a, b in ((before, after), (np.cross(before, k_in), np.cross(after, k_out))):
        out += b[:, :, None] * np.einsum("pi,pij->pj", a, field)[:, None, :]
    matrix = np.stack(polarisation_basis(-k_out), axis=1) @ out
    return np.asarray(matrix * (factor * wavelength_m / (4.0 * np.pi * straight))[:, None, None], np.complex128)


def _across(vector: Floats, along: Floats) -> Floats:
    return np.asarray(vector - np.einsum("pi,pi->p", vector, along)[:, None] * along, np.float64)
