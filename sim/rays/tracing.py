"""Specular paths between any transmitters and receivers in a city: the image method with exact visibility.

Source: image method, docs/explanation/rays.md; gain as in equation 3 of the extended FastSLAM paper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.city.city import City, Floats, Ints
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation
from cellslam.sim.progress import Progress, silent
from cellslam.sim.rays.diffraction import diffracted_paths, diffraction_gain
from cellslam.sim.rays.first_order import lines_of_sight, single_reflections
from cellslam.sim.rays.gain import path_gain
from cellslam.sim.rays.paths import MAX_ORDER, Found, Paths, all_found, joined
from cellslam.sim.rays.scene import Scene, prepare
from cellslam.sim.rays.second_order import double_reflections

CHUNK = 8192
# From so many receivers on it pays to find out first which facets the transmitter sees.
ILLUMINATED_FROM = 5000
SAME_IMAGE_M = 1e-3


def trace(
    city: City | Scene,
    transmitters: ArrayLike,
    receivers: ArrayLike,
    max_order: int = 1,
    *,
    carrier_hz: float = 2.66e9,
    ground_reflection: bool = False,
    diffraction: bool = False,
    progress: Progress = silent,
) -> Paths:
    """Return all specular paths up to `max_order` reflections from transmitters (S, 3) to receivers (N, 3),
    in metres; with `diffraction` also those over one edge of a building.

    Receivers in the order of a drive are fastest. Raises InputError for positions that are not finite or not
    (n, 3), and for an order or a carrier that cannot be used.
    """
    scene = city if isinstance(city, Scene) else prepare(city)
    if max_order not in range(MAX_ORDER + 1):
        raise InputError(f"max_order {max_order} is not available: 0 to {MAX_ORDER}")
    if not 1e8 <= carrier_hz <= 1e11:
        raise InputError(f"carrier_hz {carrier_hz:g} is outside 1e8 to 1e11 Hz, where ITU-R P.2040 holds")
    t, r = (_positions(n, p) for n, p in (("transmitters", transmitters), ("receivers", receivers)))
    t, r = t - scene.origin_m, r - scene.origin_m
    reflects = (scene.city.facets.area_m2 > 0.0) if ground_reflection else scene.reflects
    pieces = []
    with progress("tracing rays", len(t) * len(r)) as advance:
        for site in range(len(t)):
            worth = max_order >= 2 or (max_order == 1 and len(r) >= ILLUMINATED_FROM)
            illuminated = scene.illuminated_facets(t[site], reflects) if worth else np.flatnonzero(reflects)
            for start in range(0, len(r), CHUNK):
                part = r[start : start + CHUNK]
                found = [_search(scene, t[site], part, max_order, reflects, illuminated)]
                if diffraction:
                    found.append(diffracted_paths(scene, t[site], part, SPEED_OF_LIGHT_MPS / carrier_hz))
                pieces.append(_describe(scene, t[site], site, part, start, all_found(found), carrier_hz))
                advance(len(part))
    nothing = Found.of(np.empty(0, np.int64))
    return joined(pieces or [_describe(scene, np.zeros(3), 0, r[:0], 0, nothing, carrier_hz)])


def _positions(name: str, positions: ArrayLike) -> Floats:
    array = np.array(positions, np.float64, order="C")  # kernels are compiled for each order again
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name} have shape {array.shape}, expected (n, 3): x, y, z in metres")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InputError(f"{name}, row {bad[0]}: {array[bad[0]].tolist()} is not finite")
    return array


def _search(
    scene: Scene, transmitter: Floats, receivers: Floats, max_order: int, reflects: NDArray[np.bool_], illuminated: Ints
) -> Found:
    """Return the free paths of one transmitter over facets, centred coordinates."""
    pieces = [lines_of_sight(scene, transmitter, receivers)]
    if max_order >= 1:
        seen = np.zeros(len(reflects), np.bool_)
        seen[illuminated] = True
        pieces.append(single_reflections(scene, transmitter, receivers, seen))
    if max_order >= 2:
        pieces.append(double_reflections(scene, transmitter, receivers, reflects, illuminated))
    return all_found(pieces)


def _describe(
    scene: Scene, transmitter: Floats, site: int, receivers: Floats, first_receiver: int, found: Found,
    carrier_hz: float,
) -> Paths:  # fmt: skip
    """Turn what was found into paths: images, angles, gains; copies removed."""
    bent = found.edge >= 0
    vt = images_of(scene, transmitter, found.facets)
    start, end = found.points[bent, 0], receivers[found.row[bent]]
    last = np.linalg.norm(start - end, axis=1, keepdims=True)
    vt[bent] = end + (start - end) * (1.0 + np.linalg.norm(start - transmitter, axis=1, keepdims=True) / last)
    order = (found.facets >= 0).sum(axis=1) + bent
    keep = _first_of_copies(found.row, order, vt, found.facets)
    found, order, vt, bent = found.take(keep), order[keep], vt[keep], bent[keep]
    receiver = receivers[found.row]
    corners = np.empty((len(order), 4, 3))
    corners[:, 0], corners[:, 1:3] = transmitter, found.points
    corners[:, 3] = receiver
    corners[np.arange(len(order)), order + 1] = receiver
    azimuth, elevation = azimuth_elevation(vt - receiver)
    departure_azimuth, departure_elevation = azimuth_elevation(corners[:, 1] - transmitter)
    table = scene.city.facets
    gain = np.empty((len(order), 2, 2), np.complex128)
    gain[~bent] = path_gain(
        corners[~bent],
        order[~bent],
        found.facets[~bent],
        table.normal,
        table.material,
        scene.city.materials,
        carrier_hz,
    )
    if bent.any():
        t, point, r = corners[bent, :3].transpose(1, 0, 2)
        gain[bent] = diffraction_gain(scene.edges, found.edge[bent], t, point, r, SPEED_OF_LIGHT_MPS / carrier_hz)
    return Paths(
        receiver=found.row + first_receiver,
        transmitter=np.full(len(order), site, np.int64),
        order=order,
        facets=found.facets,
        edge=found.edge,
        points_m=found.points + scene.origin_m,
        vt_position_m=vt + scene.origin_m,
        length_m=np.linalg.norm(vt - receiver, axis=1),
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        departure_azimuth_rad=departure_azimuth,
        departure_elevation_rad=departure_elevation,
        gain=gain,
    )


def images_of(scene: Scene, transmitter: Floats, facets: Ints) -> Floats:
    """Return the transmitter (3,) mirrored in the facets (P, 2), first column first, -1 none; centred
    coordinates (P, 3) in m.
    """
    image = np.tile(transmitter, (len(facets), 1))
    for column in range(facets.shape[1]):
        rows = np.flatnonzero(facets[:, column] >= 0)
        plane = scene.table[facets[rows, column]]
        distance = np.einsum("pi,pi->p", plane[:, :3], image[rows]) - plane[:, 3]
        image[rows] -= 2.0 * distance[:, None] * plane[:, :3]
    return image


def _first_of_copies(row: Ints, order: Ints, vt: Floats, facets: Ints) -> Ints:
    """Return the rows that remain when paths of one receiver and one image (within a millimetre) count once.

    Copies come from geometry that is there twice; the path of the lowest facet stays.
    """
    sequence = np.lexsort((facets[:, 1], facets[:, 0], vt[:, 0], order, row))
    keep = np.ones(len(row), np.bool_)
    for step in range(1, 4):
        a, b = sequence[:-step], sequence[step:]
        same = (
            (row[a] == row[b])
            & (order[a] == order[b])
            & (np.abs(vt[a] - vt[b]).max(axis=1, initial=0.0) < SAME_IMAGE_M)
        )
        keep[np.where(facets[a, 0] <= facets[b, 0], b, a)[same]] = False
    return np.flatnonzero(keep)
