"""Cities from files: meshes that trimesh reads, Mitsuba scenes, CityJSON, OpenStreetMap."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from shapely.affinity import translate

from cellslam.sim.city.assemble import Part, assemble
from cellslam.sim.city.city import City, Floats, Ints, Material, Tolerances
from cellslam.sim.city.city_config import MeshCityConfig
from cellslam.sim.city.facets import connected, weld
from cellslam.sim.city.files.cityjson import read_cityjson
from cellslam.sim.city.files.mitsuba import DISTRIBUTION, building_name, read_scene, shipped_scene
from cellslam.sim.city.files.osm import load_osm
from cellslam.sim.city.footprints import buildings, ground_objects
from cellslam.sim.city.materials import ITU_P2040, itu_material, itu_name
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.plausible import RANGES

UPRIGHT = 0.5  # height over length from which on a city is taken to lie on its side
FORMATS = (".ply", ".obj", ".stl", ".glb", ".gltf", ".xml", ".json", ".jsonl", ".osm", ".pbf")


@dataclass(frozen=True)
class MeshObject:
    """One mesh of a file: `vertices` (V, 3) in metres, `triangles` (K, 3), its building if that is known.

    `assumed`: what the file calls its material ('' nothing), where that tells nothing of it.
    """

    vertices: Floats
    triangles: Ints
    material: Material
    building: str | None
    assumed: str | None


def load_city(config: MeshCityConfig) -> City:
    """Return the city of a mesh file or a shipped scene. Raises InputError for whatever is wrong with it."""
    path = _locate(config.path)
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"cannot read mesh '{config.path}': {error.strerror or 'no such file'}") from None
    if status.st_size == 0:
        raise InputError(f"'{config.path}' is empty: the file has no content")
    return _load(config, path, status.st_mtime_ns)


@lru_cache(maxsize=2)
def _load(config: MeshCityConfig, path: Path, stamp: int) -> City:
    del stamp  # part of the key: a file that has changed is read again
    tolerances = Tolerances(config.plane_tolerance_m, config.angle_tolerance_deg)
    if path.suffix.lower() in (".osm", ".pbf"):
        return load_osm(path, config.material, config.roughness_m, tolerances)
    default = itu_material(config.material, config.thickness_m, config.roughness_m)
    objects = [o for o in _objects(path, default, config) if len(o.triangles)]
    if not objects:
        raise InputError(f"mesh '{config.path}' has no triangles: it is empty, or no mesh")
    for o in objects:
        if not np.isfinite(o.vertices).all():
            where = f" of '{o.building}'" if o.building else ""
            raise InputError(f"mesh '{config.path}' has a vertex{where} that is not finite (NaN): repair the file")
        RANGES["position"].check(float(o.vertices.flat[np.abs(o.vertices).argmax()]), f"mesh '{config.path}': a vertex")
    return _city(path.stem, objects, tolerances)


def _locate(path: str) -> Path:
    prefix, _, name = path.partition(":")
    if prefix == DISTRIBUTION:
        return shipped_scene(name)
    file = Path(path).expanduser()
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            f"mesh '{path}' has the format '{file.suffix}'; allowed: {', '.join(FORMATS)}, {DISTRIBUTION}:NAME"
        )
    return file


def _objects(path: Path, default: Material, config: MeshCityConfig) -> Iterator[MeshObject]:
    suffix = path.suffix.lower()
    if suffix == ".xml":
        for shape in read_scene(path, default):
            for vertices, triangles, _ in _read_mesh(shape.path):
                placed = vertices @ shape.to_world[:3, :3].T + shape.to_world[:3, 3]
                yield MeshObject(placed, triangles, shape.material, building_name(shape.name), shape.assumed)
    elif suffix in (".json", ".jsonl"):
        for vertices, triangles, building in read_cityjson(path):
            yield MeshObject(vertices, triangles, default, building, "")
    else:
        y_up = config.up == "y" or (config.up == "auto" and suffix in (".glb", ".gltf"))
        for vertices, triangles, name in _read_mesh(path):
            placed = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0] if y_up else vertices
            known = itu_name(name)
            found = itu_material(known, config.thickness_m, config.roughness_m) if known in ITU_P2040 else None
            yield MeshObject(placed, triangles, found or default, None, None if found else name)


def _read_mesh(path: Path) -> Iterator[tuple[Floats, Ints, str]]:
    """Yield (vertices, triangles, material name or '') of every mesh in a file."""
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = trimesh.load(str(path), process=False)
            found = [_arrays(mesh) for mesh in (loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded])]
    except ModuleNotFoundError:  # trimesh asks for a package that guesses encodings
        raise InputError(f"cannot read mesh '{path}': its text is not UTF-8; is it damaged?") from None
    except Exception as error:  # a parser meets garbage in its own way each time
        text = one_line(error, 160) or type(error).__name__
        raise InputError(f"cannot read mesh '{path}': {text}") from None
    yield from (mesh for mesh in found if mesh is not None)


def _arrays(mesh: Any) -> tuple[Floats, Ints, str] | None:
    if not hasattr(mesh, "faces") or len(mesh.faces) == 0:
        return None
    vertices = np.array(mesh.vertices, np.float64)
    faces = np.array(mesh.faces, np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("faces point to vertices that do not exist")
    material = getattr(getattr(mesh, "visual", None), "material", None)
    return vertices, faces, str(getattr(material, "name", None) or "")


def _city(name: str, objects: list[MeshObject], tolerances: Tolerances) -> City:
    """Tell ground from buildings and put the objects together."""
    materials = list(dict.fromkeys(o.material for o in objects))
    corners = np.concatenate([o.vertices[o.triangles] for o in objects])
    counts = [len(o.triangles) for o in objects]
    item = np.repeat(np.arange(len(objects)), counts)
    group = _groups(objects)
    ground = np.isin(group, ground_objects(corners - corners.mean(axis=(0, 1)), group))
    origin = np.round(corners.mean(axis=(0, 1)))
    footprints, heights, building = buildings(corners - origin, group, ground)
    footprints = tuple(translate(p, *origin[:2]) for p in footprints)
    parts = []
    for index, obj in enumerate(objects):
        own = building[item == index]
        for value in np.unique(own):
            triangles = obj.triangles[own == value]
            used, renumbered = np.unique(triangles, return_inverse=True)
            parts.append(Part(obj.vertices[used], renumbered.reshape(-1, 3), materials.index(obj.material), int(value)))
    road_m = _foot(corners, building) if footprints and not ground.any() else 0.0
    notes = [] if ground.any() else [f"no ground found: nothing spans the city and faces up; roads at {road_m:g} m"]
    notes += _assumptions(objects) + _lying(np.ptp(corners, axis=(0, 1)))
    city = assemble(name, parts, materials, footprints, heights, notes=notes, tolerances=tolerances)
    return replace(city, road_m=road_m)


def _lying(size_m: Floats) -> list[str]:
    """Return a note on a city that is about as high as it is long: its upward axis may be another one."""
    x, y, z = size_m.tolist()
    if z < UPRIGHT * max(x, y):
        return []
    return [f"{z:.0f} m high, and {x:.0f} x {y:.0f} m long: if another axis is up, say so (--up y or z, city.up)"]


def _foot(corners: Floats, building: Ints) -> float:
    """Return the height in m at which half of the buildings stand or lower, of triangles (K, 3, 3)."""
    own = building >= 0
    lowest = np.full(int(building.max()) + 1, np.inf)
    np.minimum.at(lowest, building[own], corners[own, :, 2].min(axis=1))
    return round(float(np.median(lowest)), 1)


def _assumptions(objects: list[MeshObject]) -> list[str]:
    """Return a note on the objects whose material is assumed."""
    assumed = [o for o in objects if o.assumed is not None]
    if not assumed:
        return []
    material, names = assumed[0].material, sorted({o.assumed for o in assumed if o.assumed})
    thick = "a half space" if material.thickness_m is None else f"{material.thickness_m:g} m thick"
    others = f" but {', '.join(names[:4])}{', ...' if len(names) > 4 else ''}" if names else ""
    return [
        f"{len(assumed)} of {len(objects)} objects name no known material{others}: {material.name} assumed, {thick}"
    ]


def _groups(objects: list[MeshObject]) -> Ints:
    """Return the group (K,) of each triangle: objects of one building, or one touching piece of an object."""
    names: dict[str, int] = {}
    groups, used = [], len({o.building for o in objects if o.building is not None})
    for o in objects:
        if o.building is not None:
            groups.append(np.full(len(o.triangles), names.setdefault(o.building, len(names))))
            continue
        corner = weld(o.vertices, np.zeros(len(o.vertices), np.int64))[o.triangles]
        ends = np.concatenate([corner[:, :2], corner[:, 1:]])
        label = connected(ends, int(corner.max()) + 1)
        piece = np.unique(label[corner[:, 0]], return_inverse=True)[1]
        groups.append(used + piece)
        used += int(piece.max()) + 1
    return np.concatenate(groups).astype(np.int64)
