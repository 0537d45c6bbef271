"""Damage city files at random, load what is left, and trace in it: `python tests/city/fuzz.py [INPUTS] [SEED]`.

Every input must load within ten seconds or be refused in one line. Exit status 1 if one does not.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

from cellslam.sim.city import MeshCityConfig, ProceduralCityConfig, build_city
from cellslam.sim.city.export import write_scene
from cellslam.sim.errors import InputError
from cellslam.sim.rays import trace

SLOW_S = 10.0
HOUSE = {
    "type": "CityJSON", "version": "2.0", "transform": {"scale": [0.01, 0.01, 0.01], "translate": [5e5, 5e6, 0.0]},
    "CityObjects": {"h": {"type": "Building", "geometry": [{"type": "Solid", "lod": "1", "boundaries": [[
        [[0, 3, 2, 1]], [[4, 5, 6, 7]], [[0, 1, 5, 4]], [[1, 2, 6, 5]], [[2, 3, 7, 6]], [[3, 0, 4, 7]]]]}]}},
    "vertices": [[0, 0, 0], [1000, 0, 0], [1000, 800, 0], [0, 800, 0],
                 [0, 0, 900], [1000, 0, 900], [1000, 800, 900], [0, 800, 900]],
}  # fmt: skip
OSM = """<osm version="0.6">
<node id="1" version="1" lat="48.1" lon="11.5"/><node id="2" version="1" lat="48.1" lon="11.501"/>
<node id="3" version="1" lat="48.101" lon="11.501"/><node id="4" version="1" lat="48.101" lon="11.5"/>
<way id="1" version="1"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="4"/><nd ref="1"/>
<tag k="building" v="yes"/><tag k="height" v="12"/></way></osm>"""


def samples(folder: Path) -> dict[str, bytes]:
    """Return one sound file of each format by suffix."""
    boxes = [trimesh.creation.box((10.0, 8.0, 6.0 + i)).apply_translation((20.0 * i, 0.0, 3.0)) for i in range(3)]
    village = trimesh.util.concatenate(boxes)
    found = {}
    for suffix in (".ply", ".obj", ".stl", ".glb"):
        village.export(folder / f"sample{suffix}")
        found[suffix] = (folder / f"sample{suffix}").read_bytes()
    config = ProceduralCityConfig(extent_m=200.0, block_size_m=100.0)
    write_scene(build_city(config, np.random.default_rng(0)), folder / "sample.xml")
    found[".xml"] = (folder / "sample.xml").read_bytes()
    return {**found, ".json": json.dumps(HOUSE).encode(), ".osm": OSM.encode()}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return `data` with some bytes changed, cut out or repeated; half the time numerals alone change."""
    out = bytearray(data)
    numerals = [i for i, byte in enumerate(out) if chr(byte).isdecimal()]
    if numerals and rng.random() < 0.5:
        for at in rng.choice(numerals, int(rng.integers(1, 9))):
            out[at] = int(rng.choice(list(b"0123456789-.e")))
        return bytes(out)
    for _ in range(int(rng.geometric(0.4))):
        at, size = int(rng.integers(max(len(out), 1))), int(rng.integers(1, 40))
        kind = rng.random()
        if kind < 0.9 and out:
            out[at] = int(rng.integers(256))
        elif kind < 0.95:
            del out[at : at + size]
        else:
            out[at:at] = out[at : at + size]
    return bytes(out)


def main(inputs: int, first: int) -> int:
    """Try `inputs` files and return how many were neither loaded nor refused properly."""
    bad = loaded = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sound = samples(folder)
        for seed in range(first, first + inputs):
            rng = np.random.default_rng(seed)
            suffix = list(sound)[seed % len(sound)]
            path = folder / f"damaged{suffix}"
            path.write_bytes(damaged(sound[suffix], rng))
            begin = time.perf_counter()
            try:
                city = build_city(MeshCityConfig(path=str(path)), rng)
                trace(city, [[5.0, -20.0, 3.0]], [[9.0, -15.0, 1.5]])
                loaded += 1
                problem = ""
            except InputError as error:
                problem = "more than one line" if "\n" in str(error) else ""
            except Exception as error:
                problem = f"{type(error).__name__}: {error}"
            if time.perf_counter() - begin > SLOW_S:
                problem = problem or f"{time.perf_counter() - begin:.1f} s"
            if problem:
                bad += 1
                sys.stdout.write(f"seed {seed} ({suffix}): {problem}\n")
    sys.stdout.write(f"{inputs} inputs: {loaded} loaded, {inputs - loaded - bad} refused, {bad} wrong\n")
    return bad


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*numbers[:1] or [10_000], *numbers[1:2] or [0]) > 0)
