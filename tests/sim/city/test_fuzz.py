"""Damaged city files load or are refused in one line: a hundred here, as many as CELLSLAM_FUZZ says by

CELLSLAM_FUZZ=10000 pytest tests/sim/city/test_fuzz.py --hypothesis-show-statistics
"""

from __future__ import annotations

import json
import os

import numpy as np
import osmium
import pytest
import trimesh
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from trimesh.exchange.gltf import export_gltf

from cellslam.sim.city import MeshCityConfig, ProceduralCityConfig, build_city
from cellslam.sim.city.files.mitsuba import write_scene
from cellslam.sim.errors import InputError
from cellslam.sim.rays import trace
from tests.sim.city.test_cityjson import FEATURE, HEAD, HOUSE
from tests.sim.city.test_osm import Extract, square

INPUTS = int(os.environ.get("CELLSLAM_FUZZ", "100"))
SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf", ".xml", ".json", ".jsonl", ".osm", ".osm.pbf")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return one sound file of each format, and the folder with the parts of the Mitsuba scene."""
    folder = tmp_path_factory.mktemp("sound")
    boxes = [trimesh.creation.box((10.0, 8.0, 6.0 + i)).apply_translation((20.0 * i, 0.0, 3.0)) for i in range(3)]
    village = trimesh.util.concatenate(boxes)
    for suffix in (".ply", ".obj", ".stl", ".glb"):
        village.export(folder / f"sample{suffix}")
    (folder / "sample.gltf").write_bytes(export_gltf(village.scene(), embed_buffers=True)["model.gltf"])
    config = ProceduralCityConfig(extent_m=200.0, block_size_m=100.0)
    write_scene(build_city(config, np.random.default_rng(0)), folder / "sample.xml")
    (folder / "sample.json").write_text(json.dumps(HOUSE))
    (folder / "sample.jsonl").write_text("\n".join(json.dumps(document) for document in (HEAD, FEATURE)))
    extract = Extract()
    extract.way(square(0, 0, 20), building="yes", height="12")
    extract.write(folder / "sample.osm")
    with osmium.SimpleWriter(str(folder / "sample.osm.pbf")) as writer:
        for item in osmium.FileProcessor(str(folder / "sample.osm")):
            writer.add(item)
    return folder, {suffix: (folder / f"sample{suffix}").read_bytes() for suffix in SUFFIXES}


def attempt(path):
    """Return whether a file loads and lets rays be traced; InputError in one line is the only other end."""
    try:
        city = build_city(MeshCityConfig(path=str(path)), np.random.default_rng(0))
    except InputError as error:
        assert "\n" not in str(error)
        return False
    paths = trace(city, [[5.0, -20.0, 3.0]], [[9.0, -15.0, 1.5]], max_order=2, diffraction=True)
    assert np.isfinite(paths.length_m).all()
    assert np.isfinite(paths.gain).all()
    return True


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_sound_files_load(sound, suffix):
    assert attempt(sound[0] / f"sample{suffix}")


def damaged(data, rng):
    """Return `data` with some bytes changed or a piece cut out or repeated; half the time numerals alone change."""
    out = bytearray(data)
    numerals = [i for i, byte in enumerate(out) if chr(byte).isdecimal()]
    if numerals and rng.random() < 0.5:
        for at in rng.choice(numerals, int(rng.integers(1, 9))):
            out[at] = int(rng.choice(list(b"0123456789-.e")))
        return bytes(out)
    for at in rng.integers(len(out), size=rng.geometric(0.4)):
        out[at] = int(rng.integers(256))
    if rng.random() < 0.2:
        at, size = int(rng.integers(len(out))), int(rng.integers(1, 40))
        out[at : at + size] = out[at : at + size] * int(rng.choice([0, 2]))
    return bytes(out)


def check(sound, suffix, content):
    path = sound[0] / f"damaged{suffix}"
    path.write_bytes(content)
    event(f"{suffix} {'loaded' if attempt(path) else 'refused'}")


@settings(max_examples=INPUTS, deadline=20_000, database=None, suppress_health_check=list(HealthCheck))
@given(suffix=st.sampled_from(SUFFIXES), seed=st.integers(0, 2**63))
def test_damaged_files_load_or_are_refused(sound, suffix, seed):
    check(sound, suffix, damaged(sound[1][suffix], np.random.default_rng(seed)))


@settings(max_examples=INPUTS // 2, deadline=20_000, database=None, suppress_health_check=list(HealthCheck))
@given(suffix=st.sampled_from(SUFFIXES), content=st.binary(max_size=400))
def test_any_bytes_load_or_are_refused(sound, suffix, content):
    check(sound, suffix, content)
