"""A city to files: a Mitsuba XML scene with one PLY mesh per building and material, as Sionna RT reads them."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from cellslam.sim.city.city import GROUND, City, Ints

HALF_SPACE_M = 10.0
"""Thickness written for a wall without one: scene files know no half space."""


def write_scene(city: City, path: Path) -> None:
    """Write `path` (.xml) and its meshes in the folder `meshes` beside it; coordinates keep double precision."""
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
