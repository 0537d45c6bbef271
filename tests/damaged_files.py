"""Sound files of every kind that cellslam reads, their readers, and damage: for fuzz tests."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.io
from pydantic import BaseModel

from cellslam.benchmarks.sweeps.rows import oracles, provenance, results, varying_keys
from cellslam.benchmarks.sweeps.store import DATABASE, lost_in_words
from cellslam.benchmarks.sweeps.trajectories import unpack
from cellslam.cli.commands.init import _read_geo_file as places
from cellslam.recordings.importing.importing import import_folder
from cellslam.scenarios import sweep_points
from cellslam.scenarios.loading import load
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.city import City, MeshCityConfig, ProceduralCityConfig, build_city
from cellslam.sim.city.files.mitsuba import write_scene
from cellslam.sim.errors import InputError
from cellslam.sim.rays import trace
from cellslam.sim.rays.exchange import read_sionna
from cellslam.sim.recording import Recording
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.vt_map import VtMap
from tests.benchmarks.made_up_sweeps import made_up, plan_of, trajectory
from tests.recordings.test_broken import FILES, made
from tests.sim.city.test_cityjson import FEATURE, HEAD, HOUSE
from tests.sim.city.test_osm import Extract, square
from tests.sim.rays.test_exchange import saved, sionna
from tests.slam.model.test_map_joining import drawn

CITIES = (".ply", ".obj", ".stl", ".glb", ".gltf", ".xml", ".json", ".jsonl", ".osm", ".osm.pbf")
NUMERALS = list(b"0123456789-.e")
# What has stopped a reader once: put in anywhere.
STRANGE = (
    b"[" * 6000, b"9" * 5000, b"\0", b"\r", b"nan", b"-inf", b"1e300", b"-1", str(2**70).encode(), b",x" * 20_000,
    b'"', b"\xff\xfe", b"[a.b]\n", b'{"a":' * 3000,
)  # fmt: skip

Read = Callable[[Path], Any]


class Sound(NamedTuple):
    """A sound file and what reads it.

    `sealed`: whatever changes what is read of it must be refused. `stated` returns those numbers of what is read that
    stand in the file as they are: where they are others after damage, the file must say so.
    """

    path: Path
    read: Read
    sealed: bool = False
    stated: Callable[[Any], Any] | None = None


def cities(folder: Path) -> dict[str, Path]:
    """Write a sound file of each format of a city; return them by suffix."""
    import osmium
    import trimesh
    from trimesh.exchange.gltf import export_gltf

    folder.mkdir(parents=True, exist_ok=True)
    out = {suffix: folder / f"sample{suffix}" for suffix in CITIES}
    boxes = [trimesh.creation.box((10.0, 8.0, 6.0 + i)).apply_translation((20.0 * i, 0.0, 3.0)) for i in range(3)]
    village = trimesh.util.concatenate(boxes)
    for suffix in (".ply", ".obj", ".stl", ".glb"):
        village.export(out[suffix])
    out[".gltf"].write_bytes(export_gltf(village.scene(), embed_buffers=True)["model.gltf"])
    config = ProceduralCityConfig(extent_m=200.0, block_size_m=100.0)
    write_scene(build_city(config, np.random.default_rng(0)), out[".xml"])
    out[".json"].write_text(json.dumps(HOUSE))
    out[".jsonl"].write_text("\n".join(json.dumps(document) for document in (HEAD, FEATURE)))
    extract = Extract()
    extract.way(square(0, 0, 20), building="yes", height="12")
    extract.write(out[".osm"])
    with osmium.SimpleWriter(str(out[".osm.pbf"])) as writer:
        for item in osmium.FileProcessor(str(out[".osm"])):
            writer.add(item)
    return out


def read_city(path: Path) -> City:
    """Load a city and trace rays in it."""
    city = build_city(MeshCityConfig(path=str(path)), np.random.default_rng(0))
    paths = trace(city, [[5.0, -20.0, 3.0]], [[9.0, -15.0, 1.5]], max_order=2, diffraction=True)
    assert np.isfinite(paths.length_m).all()
    assert np.isfinite(paths.gain).all()
    return city


def read_recording(path: Path, changed: bool = False) -> Recording:
    """Load a recording and what it says of its origin."""
    recording = Recording.load(path, changed)
    Origin.of(recording, path)
    return recording


def read_campaign(path: Path) -> Recording:
    """Import the campaign that a table is of."""
    return import_folder(path.parent)


def read_results(path: Path) -> Any:
    """Read a folder of results as `table` and `report` do."""
    rows = results(path.parent)
    varying_keys(path.parent), provenance(path.parent), lost_in_words(path.parent)
    return rows, oracles(path.parent)


def sound_files(folder: Path) -> dict[str, Sound]:
    """Write a sound file of each kind into `folder`."""
    out = {f"city{s}": Sound(p, read_city) for s, p in cities(folder / "cities").items()}
    out["city.obj"] = out["city.obj"]._replace(stated=lambda city: city.vertices)
    stated: dict[str, Callable[[Recording], Any]] = {
        "paths.csv": lambda r: (r.measurements.distance_m, r.measurements.snr_db),
        "gnss.csv": lambda r: None if r.reference is None else r.reference.position_m,
    }
    for name in FILES:
        place = made(folder / f"campaign-{name}")
        out[f"table {name}"] = Sound(place / name, read_campaign, stated=stated.get(name))
    place = made(folder / "campaign-mat")
    manifest = (place / "recording.toml").read_text().replace("gnss.csv", "gnss.mat")
    (place / "recording.toml").write_text(manifest)
    scipy.io.savemat(place / "gnss.mat", {"t": [0.0, 1.0, 2.0], "x": [0.0, 1.0, 2.0], "y": np.zeros(3)})
    out["table .mat"] = Sound(place / "gnss.mat", read_campaign)
    recording = folder / "drive.h5"
    import_folder(place).save(recording)
    out["recording"] = Sound(recording, read_recording, sealed=True)
    out["recording, changed"] = Sound(recording, partial(read_recording, changed=True))
    scenario = folder / "scenario.toml"
    scenario.write_text(
        '[city]\nkind = "procedural"\nseed = 3\nextent_m = 300.0\n[radio]\ndetection_scale = 0.9\n'
        '[[sites]]\nname = "A"\ncells = [{cell_id = 375}]\nposition_m = [10.0, 20.0, 30.0]\n'
        "[estimator.fastslam]\nparticles = 50\n"
    )
    out["scenario"] = Sound(scenario, load, stated=lambda scenario: scenario.model_dump())
    sweep = folder / "sweep.toml"
    sweep.write_text(
        'scenario = "tiny"\n[set]\n"radio.clutter_scale" = 2.0\n[grid]\n"vehicle.speed_mps" = [1.0, 2.0]\n'
    )
    out["sweep"] = Sound(sweep, sweep_points.read, stated=lambda sweep: sweep)
    drawn(4, np.random.default_rng(0)).save(folder / "map.h5")
    out["map"] = Sound(folder / "map.h5", VtMap.load, sealed=True)
    size, covariance = np.array([0.2, 0.0, 0.0]), np.array([[0.02, 0.01], [0.01, 0.03]])
    field = size, np.radians(15.0), 1.1, 1.9, np.zeros(2, int), np.array([4, 9]), np.array([0.1, -0.3]), covariance
    Calibration(*field).save(folder / "calibration.h5")
    out["calibration"] = Sound(folder / "calibration.h5", Calibration.load, sealed=True)
    out["paths .npz"] = Sound(saved(folder, sionna()), read_sionna, sealed=True)
    plan = plan_of({}, trials=30)
    made_up(folder / "results", plan, lambda task, _: {"position_rmse_m": 1.5 + task.trial})
    out["results"] = Sound(folder / "results" / DATABASE, read_results, sealed=True)
    geo = folder / "route.geojson"
    points = [[13.1, 55.7], [13.2, 55.8]]
    geo.write_text(json.dumps({"type": "Feature", "geometry": {"type": "LineString", "coordinates": points}}))
    out["places"] = Sound(geo, places, stated=lambda places: places)
    (folder / "trajectory.npz").write_bytes(trajectory())
    out["trajectory"] = Sound(folder / "trajectory.npz", unpack, sealed=True)
    return out


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return `data` with some bytes changed or a piece cut out, repeated or put in; half the time numerals alone
    change; now and then arbitrary bytes."""
    if rng.random() < 0.05:
        return rng.bytes(int(rng.integers(400)))
    out = bytearray(data)
    numerals = [i for i, byte in enumerate(out) if chr(byte).isdecimal()]
    if numerals and rng.random() < 0.5:
        for at in rng.choice(numerals, int(rng.integers(1, 9))):
            out[at] = int(rng.choice(NUMERALS))
        return bytes(out)
    for at in rng.integers(len(out), size=rng.geometric(0.4)):
        out[at] = int(rng.integers(256))
    if rng.random() < 0.2:
        at, size = int(rng.integers(len(out))), int(rng.integers(1, 40))
        out[at : at + size] = out[at : at + size] * int(rng.choice([0, 2]))
    if rng.random() < 0.3:
        at = int(rng.integers(len(out) + 1))
        out[at:at] = STRANGE[int(rng.integers(len(STRANGE)))]
    if rng.random() < 0.1:
        del out[int(rng.integers(len(out))) :]
    return bytes(out)


def values(held: Any) -> Iterator[Any]:
    """Yield every number and text in what was read."""
    if isinstance(held, pd.DataFrame):
        held = held.to_dict("list")
    elif isinstance(held, BaseModel):
        held = held.model_dump()
    elif is_dataclass(held):
        held = vars(held)
    if isinstance(held, np.ndarray):
        held = held.tolist()
    if isinstance(held, dict | list | tuple | set | frozenset):
        for one in held.items() if isinstance(held, dict) else sorted(held) if isinstance(held, set) else held:
            yield from values(one)
    else:
        yield held


def read(path: Path, kind: Sound, before: Any) -> str:
    """Return what comes of reading a damaged file: "refused", with an InputError of one line; "the same", with the
    values that were read `before` the damage; or "as it says", with others that a file without a seal states now.

    Any other end is an error of the reader.
    """
    try:
        held = kind.read(path)
    except InputError as error:
        assert "\n" not in str(error), f"more than a line: {error}"
        return "refused"
    if repr([*values(held)]) == repr([*values(before)]):
        return "the same"
    assert not kind.sealed, "other values, without a word to the user"
    if kind.stated is not None:
        numerals = re.findall(r"[-+]?[\d_]*\.?\d[\d_]*(?:[eE][-+]?\d+)?", path.read_text(errors="replace"))
        known = {float(text.replace("_", "")) for text in numerals}
        known |= {float(one) for one in values(kind.stated(before)) if isinstance(one, int | float)}
        for one in values(kind.stated(held)):
            assert not isinstance(one, int | float) or one != one or one in known, f"{one} does not stand in the file"
    return "as it says"


def damage_copy(sound: Path, folder: Path, rng: np.random.Generator) -> Path:
    """Copy the folder of a sound file, with damage to this one; return it there."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound.parent, folder, ignore=lambda _, names: [n for n in names if Path(sound.parent, n).is_dir()])
    path = folder / sound.name
    path.write_bytes(damaged(sound.read_bytes(), rng))
    return path
