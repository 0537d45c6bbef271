"""Small scenes made of rectangles, and a slow tracer to compare with."""

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


def city_of(*meshes, shift=(0.0, 0.0, 0.0), material=WALL) -> City:
    parts = [Part(v + np.asarray(shift), t, 0, i) for i, (v, t) in enumerate(meshes)]
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


def brute_force(city: City, transmitter, receiver) -> list[tuple[int, float]]:
    """Return (order, length) of all paths of order 0 and 1: triangle by triangle, in float64."""
    corners = city.vertices[city.triangles]
    found = set()
    if not _blocked(corners, transmitter, receiver):
        found.add((0, round(float(np.linalg.norm(receiver - transmitter)), 6)))
    for k, triangle in enumerate(corners):
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        normal /= np.linalg.norm(normal)
        dt, dr = (transmitter - triangle[0]) @ normal, (receiver - triangle[0]) @ normal
        if dt * dr <= 0.0:
            continue
        image = transmitter - 2.0 * dt * normal
        point = receiver + (image - receiver) * (dr / (dr + dt))
        if not _within(triangle, point):
            continue
        others = corners[city.triangle_facet != city.triangle_facet[k]]
        if not _blocked(others, receiver, point) and not _blocked(others, transmitter, point):
            found.add((1, round(float(np.linalg.norm(image - receiver)), 6)))
    return sorted(found)


def brute_force_second(city: City, transmitter, receiver) -> list[float]:
    """Return the lengths of all paths of order 2: every pair of triangles, in float64."""
    corners, label = city.vertices[city.triangles], city.triangle_facet
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = set()
    for a, b in np.argwhere(label[:, None] != label[None, :]):
        first = transmitter - 2.0 * ((transmitter - corners[a, 0]) @ normals[a]) * normals[a]
        second = first - 2.0 * ((first - corners[b, 0]) @ normals[b]) * normals[b]
        p2 = _crossing(corners[b], normals[b], receiver, second)
        p1 = None if p2 is None else _crossing(corners[a], normals[a], p2, first)
        if (
            p2 is None
            or p1 is None
            or (transmitter - corners[a, 0]) @ normals[a] * ((p2 - corners[a, 0]) @ normals[a]) <= 0
        ):
            continue
        if (first - corners[b, 0]) @ normals[b] * ((receiver - corners[b, 0]) @ normals[b]) <= 0:
            continue
        legs = ((receiver, p2, [b]), (p2, p1, [a, b]), (transmitter, p1, [a]))
        if not any(_blocked(corners[~np.isin(label, label[own])], start, end) for start, end, own in legs):
            found.add(round(float(np.linalg.norm(second - receiver)), 6))
    return sorted(found)


def _crossing(triangle, normal, start, end):
    """Return where the segment crosses the triangle, or None."""
    before, after = (start - triangle[0]) @ normal, (end - triangle[0]) @ normal
    if before * after >= 0.0:
        return None
    point = start + (end - start) * (before / (before - after))
    return point if _within(triangle, point) else None


def _within(triangle, point):
    a, b, c = triangle - point
    turns = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])
    return (turns @ np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0]) >= 0.0).all()


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
    return SimpleNamespace(
        rectangle=rectangle, city_of=city_of, box=box, brute_force=brute_force, brute_force_second=brute_force_second
    )
