"""Mitsuba XML scenes, as sionna-rt ships them: one mesh an object, a radio material each. Read, and written."""

from __future__ import annotations

import importlib.metadata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from cellslam.sim.city.city import GROUND, City, Floats, Ints, Material
from cellslam.sim.city.materials import ITU_P2040, itu_material, itu_name
from cellslam.sim.errors import InputError, one_line, unknown_name

DISTRIBUTION = "sionna-rt"
SUFFIXES = (".ply", ".obj", ".stl", ".glb")
HALF_SPACE_M = 10.0  # thickness written for a wall without one: scene files know no half space


@dataclass(frozen=True)
class Shape:
    """One object of a scene: its mesh file, its name, its material and the matrix (4, 4) that places it.

    `assumed`: what the scene calls its material, where that tells nothing of it.
    """

    name: str
    path: Path
    material: Material
    to_world: Floats
    assumed: str | None


def shipped_scene(name: str) -> Path:
    """Return the XML file of a scene of the installed sionna-rt. Raises InputError if it is not there."""
    try:
        distribution = importlib.metadata.distribution(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        raise InputError(
            f"city '{DISTRIBUTION}:{name}' needs the scenes of {DISTRIBUTION}: pip install cellslam[cities]"
        ) from None
    files = [file for file in distribution.files or () if file.suffix == ".xml" and "scenes" in file.parts]
    scenes = {file.stem: Path(str(distribution.locate_file(file))) for file in files}
    if name not in scenes:
        raise unknown_name(f"{DISTRIBUTION} scene", name, scenes)
    return scenes[name]


def read_scene(path: Path, default: Material) -> Iterator[Shape]:
    """Yield the shapes of a Mitsuba XML file. Raises InputError for what cannot be read."""
    try:
        root = ET.parse(path).getroot()
    except (OSError, ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{path}: not a readable XML scene ({one_line(error, 160)})") from None
    if root.tag != "scene":
        raise InputError(f"{path}: not a Mitsuba scene: its root is <{root.tag}>, expected <scene>")
    named = {bsdf.get("id", ""): bsdf for bsdf in root.findall("bsdf")}
    for index, shape in enumerate(root.findall("shape")):
        name = shape.get("id") or shape.get("name") or f"shape {index}"
        file = next((s.get("value", "") for s in shape.findall("string") if s.get("name") == "filename"), "")
        if Path(file).suffix.lower() not in SUFFIXES:
            raise InputError(
                f"{path}: shape '{name}' is no mesh file (type '{shape.get('type')}', filename '{file}'); "
                f"allowed: {', '.join(SUFFIXES)}"
            )
        bsdf = _bsdf(shape, named, path)
        material = None if bsdf is None else _material(bsdf, default)
        assumed = None if material else ("" if bsdf is None else bsdf.get("id", ""))
        yield Shape(name, path.parent / file, material or default, _to_world(shape, path), assumed)


def building_name(shape_name: str) -> str:
    """Return what 'mesh-NAME-walls' and 'mesh-NAME-roof' have in common: NAME."""
    name = shape_name.removeprefix("mesh-")
    return name.rsplit("-", 1)[0] if "-" in name else name


def _bsdf(shape: ET.Element, named: dict[str, ET.Element], path: Path) -> ET.Element | None:
    """Return the element of a shape's material: its own, or the one that it refers to; None: it has none."""
    own = shape.find("bsdf")
    if own is not None:
        return own
    refs = [ref.get("id", "") for ref in shape.findall("ref")]
    known = [named[ref] for ref in refs if ref in named]
    if refs and not known:
        raise InputError(f"{path}: shape '{shape.get('id')}' refers to '{refs[0]}', which the scene does not define")
    return known[0] if known else None


def _material(bsdf: ET.Element, default: Material) -> Material | None:
    """Read an 'itu-radio-material' or 'radio-material'; others are known by their id ('mat-itu_brick'), or
    not at all: None.
    """
    values = {str(e.get("name")): str(e.get("value")) for e in bsdf if e.tag in ("string", "float")}
    name = values.get("type") or itu_name(bsdf.get("id", ""))
    try:
        thickness = float(values["thickness"]) if "thickness" in values else default.thickness_m
        if "relative_permittivity" in values:
            sigma = float(values.get("conductivity", "0"))
            return Material(name, float(values["relative_permittivity"]), sigma, default.roughness_m, thickness)
    except ValueError:
        raise InputError(f"material '{bsdf.get('id')}' has a value that is no number: {values}") from None
    if "type" not in values and name not in ITU_P2040 and "itu" not in bsdf.get("id", ""):
        return None
    return itu_material(name, thickness, default.roughness_m)


def _to_world(shape: ET.Element, path: Path) -> Floats:
    matrix = np.eye(4)
    for step in next((t for t in shape.findall("transform") if t.get("name") == "to_world"), ()):
        try:
            matrix = _step(step) @ matrix
        except (ValueError, KeyError):
            raise InputError(f"{path}: shape '{shape.get('id')}' has a <{step.tag}> that cannot be read") from None
    return matrix


def _step(step: ET.Element) -> Floats:
    """Return the matrix (4, 4) of one <translate>, <scale>, <rotate> or <matrix>."""
    from trimesh.transformations import rotation_matrix

    matrix = np.eye(4)
    if step.tag == "matrix":
        values = np.array(step.attrib["value"].replace(",", " ").split(), np.float64)
        size = 4 if len(values) == 16 else 3
        matrix[:size, :size] = values.reshape(size, size)
        return matrix
    fallback = "1" if step.tag == "scale" else "0"
    vector = np.array([float(step.get(axis, fallback)) for axis in "xyz"])
    if "value" in step.attrib:
        given = np.array(step.attrib["value"].replace(",", " ").split(), np.float64)
        vector = np.broadcast_to(given, 3) if len(given) in (1, 3) else np.full(3, np.nan)
    if step.tag == "translate":
        matrix[:3, 3] = vector
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(vector)
    elif step.tag == "rotate":
        matrix = rotation_matrix(np.radians(float(step.attrib["angle"])), vector)  # type: ignore[no-untyped-call]
    else:
        raise KeyError(step.tag)
    return matrix


def write_scene(city: City, path: Path) -> None:
    """Write `path` (.xml) and its meshes, a PLY file for each building and material, in the folder `meshes` beside it,
    as Sionna RT reads them; coordinates keep double precision.
    """
    folder = path.parent / "meshes"
    folder.mkdir(parents=True, exist_ok=True)
    building = city.facets.building[city.triangle_facet]
    material = city.facets.material[city.triangle_facet]
    lines = ["<!-- written by cellslam -->", '<scene version="2.1.0">']
    for index, m in enumerate(city.materials):
        thickness = HALF_SPACE_M if m.thickness_m is None else m.thickness_m
        lines += [
            f'    <bsdf type="itu-radio-material" id={quoteattr(f"mat-{index}-{m.name}")}>',
            f'        <string name="type" value={quoteattr(m.name)}/>',
            f'        <float name="thickness" value="{thickness:g}"/>',
            "    </bsdf>",
        ]
    for b, m_index in np.unique(np.column_stack([building, material]), axis=0):
        stem = "ground" if b == GROUND else f"building{b:04d}"
        name = f"{stem}-{city.materials[m_index].name}{m_index}"
        _write_ply(folder / f"{name}.ply", city, np.flatnonzero((building == b) & (material == m_index)))
        lines += [
            f'    <shape type="ply" id={quoteattr(f"mesh-{name}")}>',
            f'        <string name="filename" value={quoteattr(f"meshes/{name}.ply")}/>',
            '        <boolean name="face_normals" value="true"/>',
            f'        <ref id={quoteattr(f"mat-{m_index}-{city.materials[m_index].name}")} name="bsdf"/>',
            "    </shape>",
        ]
    path.write_text("\n".join([*lines, "</scene>", ""]), "utf-8")


def _write_ply(path: Path, city: City, rows: Ints) -> None:
    used, renumbered = np.unique(city.triangles[rows], return_inverse=True)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(used)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(rows)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(rows), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, renumbered.reshape(-1, 3)
    path.write_bytes(header.encode("ascii") + city.vertices[used].astype("<f8").tobytes() + faces.tobytes())
