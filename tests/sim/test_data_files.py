"""Files that once ended in a traceback, took gigabytes or never ended: one line each that names the place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from cellslam.benchmarks.sweeps.tasks import with_contents
from cellslam.cli.commands.init import _read_geo_file as places
from cellslam.recordings.importing.importing import import_folder
from cellslam.recordings.importing.matlab import variables
from cellslam.scenarios import sweep_points
from cellslam.scenarios.loading import load
from cellslam.sim.city import MeshCityConfig, build_city
from cellslam.sim.errors import InputError
from cellslam.sim.rays.exchange import read_sionna
from cellslam.sim.recording import Recording
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.vt_map import _FILE, VtMap
from tests.recordings.test_broken import made

DIGITS = "9" * 4301


def city(path: Path) -> object:
    return build_city(MeshCityConfig(path=str(path)), np.random.default_rng(0))


def cityjson(number: int) -> str:
    solid = f'{{"type": "MultiSurface", "boundaries": [[[0, 1, {number}]]]}}'
    objects = f'{{"a": {{"type": "Building", "geometry": [{solid}]}}}}'
    return f'{{"type": "CityJSON", "version": "2.0", "CityObjects": {objects}, "vertices": [[0,0,0],[9,0,0],[0,9,0]]}}'


STRANGE: dict[str, tuple[str, Callable[[Path], object], str, str]] = {
    "deep TOML": ("a.toml", load, "x = " + "[" * 5000, "nested too deep"),
    "digits in TOML": ("a.toml", load, f"x = {DIGITS}", "4300 digits"),
    "deep sweep": ("a.toml", sweep_points.read, "scenario = " + "[" * 5000, "nested too deep"),
    "sweep of other bytes": ("a.toml", sweep_points.read, "scenario = '\udcff'", "not a sweep file"),
    "negative seed of a city": (
        "a.toml",
        load,
        '[city]\nkind = "procedural"\nseed = -1',
        "must be an integer at least 0 or 'trial'",
    ),
    "NUL in a name": ("a.toml", load, '[city]\nkind = "mesh"\npath = "a\\u0000.ply"', "city.path .* NUL"),
    "deep CityJSON": ("a.json", city, '{"a":' * 100_000, "nested too deep"),
    "index of CityJSON": ("a.json", city, cityjson(2**70), "specification"),
    "OBJ": ("a.obj", city, "v 0 0 0\nv 1e300 0 0\nv 0 9 9\nf 1 2 3\n", "a vertex: 1e\\+300 m cannot be"),
    "deep GeoJSON": ("a.geojson", places, '{"type":' * 100_000, "nested too deep"),
    "broken npz": ("a.npz", read_sionna, "PK\x03\x04 and no more", "not an .npz"),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_strange_files_are_one_line(kind: str, tmp_path: Path) -> None:
    name, reader, content, words = STRANGE[kind]
    path = tmp_path / name
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=words) as found:
        reader(path)
    assert "\n" not in str(found.value) and name in str(found.value)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="a file without an end")
@pytest.mark.parametrize(("name", "words"), [("/dev/zero", "more than 256 MiB"), ("a\0.toml", "null byte")])
def test_what_is_no_file(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load(name)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="a file without an end")
@pytest.mark.parametrize("reader", [Recording.load, VtMap.load, Calibration.load])
def test_what_has_no_end(reader: Callable[[str], object]) -> None:
    with pytest.raises(InputError, match="/dev/zero: no such file"):
        reader("/dev/zero")
    assert with_contents('{"map":{"file":"/dev/zero"}}')


@pytest.mark.parametrize(
    ("line", "words"),
    [("t,tx,range,az,snr\r0,1,50,0.5,10\r", "new-line"), ("t,tx," + "a," * 1_000_000, "cells, the most are 10000")],
)
def test_lines_without_an_end(line: str, words: str, tmp_path: Path) -> None:
    folder = made(tmp_path / "c")
    (folder / "paths.csv").write_bytes(line.encode())
    with pytest.raises(InputError, match=f"paths.csv: .*{words}"):
        import_folder(folder)


def test_sizes_are_compared_before_they_are_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("x", (10**11,), np.float64, chunks=(10**6,)).attrs["MATLAB_class"] = np.bytes_("double")
    with pytest.raises(InputError, match=r"a.mat: .*'/x' declares 100000000000 values and holds 0 bytes"):
        variables(tmp_path / "a.mat")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["format"], file.attrs["provenance"] = "cellslam map", "{}"
        for name in _FILE.units:
            file.create_dataset(name, (10**11,), np.float64, chunks=(10**6,))
    with pytest.raises(InputError, match=r"a.h5: not a map.* declares 100000000000 values"):
        VtMap.load(tmp_path / "a.h5")
    header = np.lib.format.magic(1, 0) + (118).to_bytes(2, "little")
    header += b"{'descr': '<f8', 'fortran_order': False, 'shape': (300000000,), }".ljust(117) + b"\n"
    (tmp_path / "a.npz").write_bytes(header + bytes(1000))
    with pytest.raises(InputError, match=r"a.npz: .*\(300000000,\) does not fit into 1128 bytes"):
        read_sionna(tmp_path / "a.npz")
