"""Mitsuba XML scenes, as sionna-rt ships them: one mesh an object, a radio material each."""

from __future__ import annotations

import importlib.metadata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellslam.sim.city.city import Floats, Material
from cellslam.sim.city.materials import ITU_P2040, itu_material
from cellslam.sim.errors import InputError, unknown_name

DISTRIBUTION = "sionna-rt"
SUFFIXES = (".ply", ".obj", ".stl", ".glb")


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
    scenes = {
        file.stem: Path(str(distribution.locate_file(file)))
        for file in distribution.files or ()
        if file.suffix == ".xml" and "scenes" in file.parts
    }
    if name not in scenes:
        raise unknown_name(f"{DISTRIBUTION} scene", name, scenes)
    return scenes[name]


def read_scene(path: Path, default: Material) -> Iterator[Shape]:
    """Yield the shapes of a Mitsuba XML file. Raises InputError for what cannot be read."""
    try:
        root = ET.parse(path).getroot()
    except (OSError, ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{path}: not a readable XML scene ({_one_line(error)})") from None
    if root.tag != "scene":
        raise InputError(f"{path}: not a Mitsuba scene: its root is <{root.tag}>, expected <scene>")
    named = {bsdf.get("id", ""): (_material(bsdf, default), bsdf.get("id", "")) for bsdf in root.findall("bsdf")}
    for index, shape in enumerate(root.findall("shape")):
        name = shape.get("id") or shape.get("name") or f"shape {index}"
        file = next((s.get("value", "") for s in shape.findall("string") if s.get("name") == "filename"), "")
        if Path(file).suffix.lower() not in SUFFIXES:
            raise InputError(
                f"{path}: shape '{name}' is no mesh file (type '{shape.get('type')}', filename '{file}'); "
                f"allowed: {', '.join(SUFFIXES)}"
            )
        material, assumed = _shape_material(shape, named, path, default)
        yield Shape(name, path.parent / file, material or default, _to_world(shape, path), assumed)


def building_name(shape_name: str) -> str:
    """Return what 'mesh-NAME-walls' and 'mesh-NAME-roof' have in common: NAME."""
    name = shape_name.removeprefix("mesh-")
    return name.rsplit("-", 1)[0] if "-" in name else name


def _shape_material(
    shape: ET.Element, named: dict[str, tuple[Material | None, str]], path: Path, default: Material
) -> tuple[Material | None, str | None]:
    """Return a shape's material, or None and what the scene calls it."""
    own = shape.find("bsdf")
    if own is not None:
        material = _material(own, default)
        return material, None if material else own.get("id", "")
    refs = [ref.get("id", "") for ref in shape.findall("ref")]
    known = [named[ref] for ref in refs if ref in named]
    if refs and not known:
        raise InputError(f"{path}: shape '{shape.get('id')}' refers to '{refs[0]}', which the scene does not define")
    material, name = known[0] if known else (None, "")
    return material, None if material else name


def _material(bsdf: ET.Element, default: Material) -> Material | None:
    """Read an 'itu-radio-material' or 'radio-material'; others are known by their id ('mat-itu_brick'), or
    not at all: None.
    """
    values = {str(e.get("name")): str(e.get("value")) for e in bsdf if e.tag in ("string", "float")}
    name = values.get("type") or bsdf.get("id", "").removeprefix("mat-").removeprefix("itu_").removeprefix("itu-")
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
    if step.tag == "matrix":
        values = np.array(step.attrib["value"].replace(",", " ").split(), np.float64)
        return values.reshape(4, 4) if len(values) == 16 else _affine(values.reshape(3, 3), np.zeros(3))
    fallback = "1" if step.tag == "scale" else "0"
    vector = np.array([float(step.get(axis, fallback)) for axis in "xyz"])
    if "value" in step.attrib:
        given = np.array(step.attrib["value"].replace(",", " ").split(), np.float64)
        vector = np.broadcast_to(given, 3) if len(given) in (1, 3) else np.full(3, np.nan)
    if step.tag == "translate":
        return _affine(np.eye(3), vector)
    if step.tag == "scale":
        return _affine(np.diag(vector), np.zeros(3))
    if step.tag != "rotate":
        raise KeyError(step.tag)
    angle, (x, y, z) = np.radians(float(step.attrib["angle"])), vector / np.linalg.norm(vector)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return _affine(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross, np.zeros(3))


def _affine(linear: Floats, shift: Floats) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, shift
    return matrix


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
