"""Mesh cities: every format gives the same city; shipped scenes load; bad files are refused in one line."""

import importlib.metadata
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh

from cellslam.sim.city import MeshCityConfig, ProceduralCityConfig, build_city
from cellslam.sim.city.files.mitsuba import write_scene
from cellslam.sim.city.inside import OUTSIDE, enclosing
from cellslam.sim.errors import InputError
from cellslam.sim.rays import trace

RNG = np.random.default_rng(0)


def load(path, **kwargs):
    return build_city(MeshCityConfig(path=str(path), **kwargs), RNG)


def village():
    """Return two houses, 10 x 8 x 6 m and 4 x 4 x 9 m, and 100 x 100 m of ground."""
    first = trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 6]])
    second = trimesh.creation.box(bounds=[[20, 0, 0], [24, 4, 9]])
    ground = trimesh.Trimesh([[-40, -50, 0], [60, -50, 0], [60, 50, 0], [-40, 50, 0]], [[0, 1, 2], [0, 2, 3]])
    return trimesh.util.concatenate([first, second, ground])


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_formats_agree(tmp_path, suffix):
    mesh = village()
    if suffix == ".glb":
        mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]  # glTF has y up
    path = tmp_path / f"village{suffix}"
    mesh.export(path)
    city = load(path)
    assert len(city.footprints) == 2
    order = np.argsort(city.heights_m)
    np.testing.assert_allclose(city.heights_m[order], [6.0, 9.0], atol=1e-5)
    np.testing.assert_allclose([city.footprints[i].area for i in order], [80.0, 16.0], atol=1e-3)
    assert len(city.facets) == 13
    assert (city.facets.building == -1).sum() == 1
    assert enclosing(city, [[40, 40, 1]]).tolist() == [OUTSIDE]
    paths = trace(city, [[5.0, -20.0, 3.0]], [[9.0, -15.0, 1.5]])
    np.testing.assert_allclose(paths.vt_position_m[1], [5.0, 20.0, 3.0], atol=1e-5)


def test_utm_coordinates_cost_no_accuracy(tmp_path):
    rng, shift = np.random.default_rng(0), np.array([500_000.0, 5_000_000.0, 0.0])
    receivers = np.column_stack([rng.uniform(-90, 90, (400, 2)), np.full(400, 1.5)])
    sites = np.array([[3.3, 4.1, 28.0]])
    town = build_city(ProceduralCityConfig(extent_m=200.0, block_size_m=100.0), np.random.default_rng(2))
    town = replace(town, vertices=np.round(town.vertices, 3))
    write_scene(town, tmp_path / "near" / "town.xml")
    write_scene(replace(town, vertices=town.vertices + shift), tmp_path / "far" / "town.xml")
    near = trace(load(tmp_path / "near" / "town.xml"), sites, receivers, diffraction=True)
    far = trace(load(tmp_path / "far" / "town.xml"), sites + shift, receivers + shift, diffraction=True)
    assert len(near) > 100
    np.testing.assert_array_equal(near.receiver, far.receiver)
    np.testing.assert_array_equal(near.order, far.order)
    # Coordinates of 5e6 m have steps of 1e-9 m in double precision, and of half a metre in single.
    np.testing.assert_allclose(near.length_m, far.length_m, atol=1e-7)
    np.testing.assert_allclose(near.azimuth_rad, far.azimuth_rad, atol=1e-8)
    np.testing.assert_allclose(near.vt_position_m + shift, far.vt_position_m, atol=1e-6)
    np.testing.assert_allclose(near.gain_db, far.gain_db, atol=1e-6)


def test_an_edited_file_is_read_again(tmp_path):
    path = tmp_path / "a.ply"
    trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 6]]).export(path)
    assert load(path).heights_m.max() == pytest.approx(6.0)
    trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 7]]).export(path)
    os.utime(path, ns=(1, 1))
    assert load(path).heights_m.max() == pytest.approx(7.0)


SCENE = """<scene version="2.1.0">
<bsdf type="itu-radio-material" id="front"><string name="type" value="brick"/>
<float name="thickness" value="0.2"/></bsdf>
<bsdf type="twosided" id="mat-itu_metal"><bsdf type="diffuse"/></bsdf>
<shape type="ply" id="mesh-house-walls">
<string name="filename" value="walls.ply"/><ref id="front" name="bsdf"/></shape>
<shape type="ply" id="mesh-house-roof">
<string name="filename" value="roof.ply"/><ref id="mat-itu_metal" name="bsdf"/></shape>
<shape type="ply" id="mesh-ground"><string name="filename" value="ground.ply"/>
<transform name="to_world"><scale value="2"/><translate x="5" y="4"/></transform></shape>
</scene>"""


def write_house(folder, text=SCENE):
    box = trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 6]])
    roof = box.face_normals[:, 2] > 0.9
    box.submesh([~roof], append=True).export(folder / "walls.ply")
    box.submesh([roof], append=True).export(folder / "roof.ply")
    ground = trimesh.Trimesh([[-25, -25, 0], [25, -25, 0], [25, 25, 0], [-25, 25, 0]], [[0, 1, 2], [0, 2, 3]])
    ground.export(folder / "ground.ply")
    (folder / "scene.xml").write_text(text)
    return folder / "scene.xml"


def test_mitsuba_scene(tmp_path):
    city = load(write_house(tmp_path))
    assert [(m.name, m.thickness_m) for m in city.materials] == [("brick", 0.2), ("metal", 0.1), ("concrete", 0.1)]
    assert len(city.footprints) == 1
    assert city.footprints[0].symmetric_difference(shapely.box(0, 0, 10, 8)).area < 0.01
    roof = city.facets.normal[:, 2] > 0.9
    assert city.materials[city.facets.material[roof & (city.facets.building == 0)][0]].name == "metal"
    np.testing.assert_allclose(city.bounds[:, :2], [[-45, -46], [55, 54]], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("brick", "brik", "unknown material 'brik'; did you mean 'brick'"),
        ("walls.ply", "wall.ply", "cannot read mesh.*wall.ply"),
        ('value="0.2"', 'value="thick"', "no number"),
        ("<scale", "<squeeze", "<squeeze> that cannot be read"),
        ('<ref id="front"', '<ref id="back"', "refers to 'back', which the scene does not define"),
        ("</scene>", "", "not a readable XML scene"),
    ],
)
def test_bad_scenes_are_refused(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message) as error:
        load(write_house(tmp_path, SCENE.replace(old, new)))
    assert "\n" not in str(error.value)


def test_materials_that_are_assumed_are_told(tmp_path):
    city = load(write_house(tmp_path, SCENE.replace("mat-itu_metal", "grey")), material="wood")
    note = "2 of 3 objects name no known material but grey: wood assumed, 0.1 m thick"
    assert note in city.notes
    village().export(tmp_path / "village.ply")
    assert any("1 of 1 objects name no known material: concrete" in n for n in load(tmp_path / "village.ply").notes)
    assert not any("material" in n for n in load("sionna-rt:simple_street_canyon").notes)


def test_shipped_scenes(monkeypatch):
    assert len(load("sionna-rt:simple_street_canyon").footprints) == 6
    with pytest.raises(InputError, match="unknown sionna-rt scene 'munic'; did you mean 'munich'"):
        load("sionna-rt:munic")

    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with pytest.raises(InputError, match=r"pip install cellslam\[cities\]"):
        load("sionna-rt:munich")


CORNERS = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 9
"""


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.ply", b"", "is empty: the file has no content"),
        ("noise.ply", bytes(range(256)) * 20, "cannot read mesh"),
        ("text.stl", b"this is no mesh\n" * 9, "has no triangles: it is empty, or no mesh"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", "has no triangles|cannot read"),
        ("nan.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "not finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "zero area"),
        ("millimetres.obj", b"v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "09 m cannot be"),
        ("latin.obj", b"# Stra\xdfe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not UTF-8"),
        ("mesh.dwg", b"", "format '.dwg'; allowed: .ply"),
        ("nowhere.ply", None, "cannot read mesh"),
        ("corners.ply", CORNERS, "do not exist"),
        ("empty.osm", b"", "is empty"),
        ("nothing.osm", b"<osm version='0.6'></osm>", "no building"),
        ("noise.osm", b"\x00\x01", "cannot"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, monkeypatch, name, content, message):
    if name == "latin.obj":
        monkeypatch.setitem(sys.modules, "charset_normalizer", None)  # an optional part of trimesh, as if not installed
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        load(path)
    assert "\n" not in str(error.value)
