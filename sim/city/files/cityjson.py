"""CityJSON 1.0 to 2.0 and CityJSONSeq: the buildings' surfaces at their highest level of detail, triangulated."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.city.assemble import ear_cut
from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.city.facets import triangle_normals
from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError, one_line

# Nesting of boundaries above a surface, by geometry type (CityJSON 2.0, section 3.2).
DEPTH = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}
Surface = list[list[int]]


def read_cityjson(path: Path) -> Iterator[tuple[Floats, Ints, str]]:
    """Yield the objects with surfaces of a .json or .jsonl file: vertices (V, 3) in the file's metres, triangles
    (K, 3), and the building that the object is part of. Raises InputError for what is no CityJSON.
    """
    try:
        text = text_of(path)
        texts = [text] if path.suffix == ".json" else [line for line in text.splitlines() if line.strip()]
        documents = [json_of(text) for text in texts]
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read CityJSON '{path}': {one_line(error, 160)}") from None
    if not documents or not isinstance(documents[0], dict) or documents[0].get("type") != "CityJSON":
        raise InputError(f'\'{path}\' is no CityJSON: expected "type": "CityJSON" at its start')
    try:
        transform = documents[0].get("transform") or {}
        scale = np.array(transform.get("scale", [1.0, 1.0, 1.0]), np.float64).reshape(3)
        shift = np.array(transform.get("translate", [0.0, 0.0, 0.0]), np.float64).reshape(3)
        for document in documents:
            vertices = np.array(document["vertices"], np.float64).reshape(-1, 3) * scale + shift
            if not np.isfinite(vertices).all():
                raise ValueError("a vertex is not finite")
            for name, entry in document["CityObjects"].items():
                triangles = _triangulate(vertices, list(_surfaces(entry)))
                if len(triangles):
                    used, renumbered = np.unique(triangles, return_inverse=True)
                    parents = entry.get("parents") or [name]
                    yield vertices[used], renumbered.reshape(-1, 3).astype(np.int64), str(parents[0])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        what = f"{type(error).__name__}: {one_line(error, 120)}"
        raise InputError(f"CityJSON '{path}' does not keep to its specification ({what})") from None


def _surfaces(entry: dict[str, Any]) -> Iterator[Surface]:
    """Yield the surfaces (rings of vertex indices, the first one outside) of an object's most detailed geometry."""
    usable = [g for g in entry.get("geometry") or [] if g["type"] in DEPTH]
    if usable:
        best = max(usable, key=lambda g: str(g.get("lod", "")))
        yield from _flatten(best["boundaries"], DEPTH[best["type"]])


def _flatten(boundaries: list[Any], depth: int) -> Iterator[Surface]:
    for item in boundaries:
        if depth == 0:
            yield item
        else:
            yield from _flatten(item, depth - 1)


def _triangulate(vertices: Floats, surfaces: list[Surface]) -> Ints:
    """Return triangles (K, 3) of all surfaces, holes left open, each turned like its outer ring."""
    pieces = [np.empty((0, 3), np.int64)]
    for rings in surfaces:
        index = np.array([i for ring in rings for i in ring], np.int64)
        if len(index) < 3:
            continue
        if index.min() < 0 or index.max() >= len(vertices):
            raise IndexError(f"vertex {index.max()} of {len(vertices)}")
        if len(index) == 3:
            pieces.append(index[None])
            continue
        points = vertices[index]
        outer = points[: len(rings[0])] - points[0]
        normal = np.cross(outer, np.roll(outer, -1, axis=0)).sum(axis=0)
        # The plane's steepest axis is dropped: no projection can fold the polygon.
        kept = [axis for axis in range(3) if axis != int(np.argmax(np.abs(normal)))]
        flat = np.ascontiguousarray(points[:, kept] - points[0, kept])
        triangles = ear_cut(flat, [len(ring) for ring in rings])
        facing = np.einsum("ki,i->k", triangle_normals(points[triangles])[0], normal) < 0.0
        triangles[facing] = triangles[facing][:, ::-1]
        pieces.append(index[triangles])
    return np.concatenate(pieces)
