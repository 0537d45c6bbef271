"""Small scenes made of rectangles, and a slow tracer to compare with."""

from itertools import pairwise, product
from types import SimpleNamespace

import numpy as np
import pytest

from cellslam.sim.city.assemble import Part, assemble
from cellslam.sim.city.city import City, Material

WALL = Material("wall", 5.24, 0.099)


def rectangle(corner, u, v):
    """Return vertices (4, 3) and triangles (2, 3) of the parallelogram corner + a u + b v."""
    corner, u, v = (np.asarray(a, np.float64) for a in (corner, u, v))
    return np.array([corner, corner + u, corner + u + v, corner + v]), np.array([[0, 1, 2], [0, 2, 3]])


def city_of(*meshes, material=WALL) -> City:
    parts = [Part(v, t, 0, i) for i, (v, t) in enumerate(meshes)]
    return assemble("test", parts, [material], [], np.zeros(len(parts)))


def box(low, high):
    """Return the mesh of an axis-parallel box without its floor."""
    (a, b, c), (d, e, f) = low, high
    sides = [
        rectangle((a, b, c), (d - a, 0, 0), (0, 0, f - c)),
        rectangle((d, b, c), (0, e - b, 0), (0, 0, f - c)),
        rectangle((d, e, c), (a - d, 0, 0), (0, 0, f - c)),
        rectangle((a, e, c), (0, b - e, 0), (0, 0, f - c)),
        rectangle((a, b, f), (d - a, 0, 0), (0, e - b, 0)),
    ]
    vertices = np.concatenate([s[0] for s in sides])
    return vertices, np.concatenate([s[1] + 4 * i for i, s in enumerate(sides)])


def brute_force(city: City, transmitter, receiver, max_order) -> list[tuple[int, float]]:
    """Return (order, length) of all paths: every sequence of triangles, in float64."""
    corners, label = city.vertices[city.triangles], city.triangle_facet
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = set()
    for order in range(max_order + 1):
        for sequence in product(range(len(corners)), repeat=order):
            images = [transmitter]
            for k in sequence:
                images.append(images[-1] - 2.0 * ((images[-1] - corners[k, 0]) @ normals[k]) * normals[k])
            points = _points(corners, normals, sequence, images, receiver)
            if points is None:
                continue
            own = [[], *([label[k]] for k in sequence), []]
            ends = [transmitter, *points, receiver]
            legs = zip(pairwise(ends), pairwise(own), strict=True)
            if not any(_blocked(corners[~np.isin(label, a + b)], start, end) for (start, end), (a, b) in legs):
                found.add((order, round(float(np.linalg.norm(images[-1] - receiver)), 6)))
    return sorted(found)


def _points(corners, normals, sequence, images, receiver):
    """Return the specular points on a sequence of triangles, or None."""
    points, place = [], receiver
    for step in reversed(range(len(sequence))):
        k = sequence[step]
        before, after = ((end - corners[k, 0]) @ normals[k] for end in (place, images[step + 1]))
        if before * after >= 0.0 or before * ((images[step] - corners[k, 0]) @ normals[k]) <= 0.0:
            return None
        place = place + (images[step + 1] - place) * (before / (before - after))
        a, b, c = corners[k] - place
        turns = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])
        if not (turns @ normals[k] >= 0.0).all():
            return None
        points.append(place)
    return points[::-1]


def _blocked(corners, start, end):
    """Moeller and Trumbore's intersection of the open segment with any triangle."""
    d = end - start
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d, e2)
    det = np.einsum("ki,ki->k", e1, p)
    usable = np.abs(det) > 1e-12
    det = np.where(usable, det, 1.0)
    s = start - corners[:, 0]
    u = np.einsum("ki,ki->k", s, p) / det
    q = np.cross(s, e1)
    v = q @ d / det
    t = np.einsum("ki,ki->k", e2, q) / det
    return bool((usable & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < 1 - 1e-9)).any())


@pytest.fixture(scope="session")
def scenes() -> SimpleNamespace:
    return SimpleNamespace(rectangle=rectangle, city_of=city_of, box=box, brute_force=brute_force)
