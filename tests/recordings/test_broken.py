"""Broken campaigns: each gives one clear line that names file, table, row and remedy, and leaves nothing
half-written.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellslam.recordings.adapters.tui_files import opened
from cellslam.recordings.importing import matlab
from cellslam.recordings.importing.importing import import_folder
from cellslam.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.sim.recording import damage as recording_guard
from tests.command_line import Run, refused
from tests.sealing import resealed

TOML = """
[measurements]
file = "paths.csv"
link = {column = "tx"}
[measurements.columns]
time_s = {column = "t", unit = "s"}
distance_m = {column = "range", unit = "m"}
azimuth_rad = {column = "az", unit = "rad"}
snr_db = {column = "snr", unit = "dB"}
[odometry]
file = "wheels.csv"
[odometry.columns]
time_s = {column = "t", unit = "s"}
u_x = {column = "v", unit = "m/s"}
u_psi = {column = "w", unit = "rad/s"}
[noise.u_x]
noise_density = 0.1
[noise.u_psi]
noise_density = 0.01
[reference]
file = "gnss.csv"
[reference.columns]
time_s = {column = "t", unit = "s"}
x_m = {column = "x", unit = "m"}
y_m = {column = "y", unit = "m"}
[start]
source = "origin"
[links.1]
site = "A"
[links.2]
site = "B"
[sites.A]
clock_offset_std_m = 0
[sites.B]
clock_offset_std_m = 100
"""
FILES = {
    "recording.toml": TOML,
    "paths.csv": "t,tx,range,az,snr\n"
    + "".join(f"{0.1 * i:.1f},{1 + i % 2},{50 + i},0.5,{10 - i}\n" for i in range(20)),
    "wheels.csv": "t,v,w\n" + "".join(f"{0.05 * i:.2f},1.0,0.1\n" for i in range(45)),
    "gnss.csv": "t,x,y\n" + "".join(f"{i},{i},0\n" for i in range(3)),
}


def swap(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def put(name: str, content: str | bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def mat(content: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        swap("recording.toml", "gnss.csv", "gnss.mat")(folder)
        (folder / "gnss.mat").write_bytes(content)

    return change


toml, paths, wheels = (partial(swap, name) for name in ("recording.toml", "paths.csv", "wheels.csv"))
new_toml, new_paths = (partial(put, name) for name in ("recording.toml", "paths.csv"))
BROKEN: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "no manifest": (remove("recording.toml"), ("recording.toml", "no such file", "--adapter")),
    "table's file missing": (remove("wheels.csv"), ("wheels.csv", "no such file")),
    "manifest not TOML": (toml("[noise.u_x]", "[noise.u_x"), ("recording.toml", "not TOML", "line")),
    "manifest empty": (new_toml(""), ("recording.toml", "'measurements' is missing")),
    "misspelled table": (toml("[odometry]", "[odometer]"), ("unknown key 'odometer", "odometry")),
    "units missing": (toml('column = "range", unit = "m"', 'column = "range"'), ("distance_m.unit", "missing")),
    "unit of another kind": (
        toml('column = "az", unit = "rad"', 'column = "az", unit = "m"'),
        ("measurements.columns.azimuth_rad", "'m' does not fit", "rad, deg"),
    ),
    "samples without rate": (
        toml('column = "range", unit = "m"', 'column = "range", unit = "samples"'),
        ("distance_m", "sample_rate_hz"),
    ),
    "negative deviation": (
        toml("clock_offset_std_m = 100", "clock_offset_std_m = -1"),
        ("sites.B.clock_offset_std_m", "-1"),
    ),
    "site not described": (toml("[sites.B]", "[sites.C]"), ("[sites.B] is missing", "clock_offset_std_m")),
    "noise missing": (toml("[noise.u_psi]\nnoise_density = 0.01\n", ""), ("[noise.u_psi] is missing", "noise_density")),
    "empty file": (new_paths(""), ("paths.csv", "empty", "header")),
    "no header": (
        new_paths(FILES["paths.csv"].split("\n", 1)[1]),
        ("paths.csv", "no column 't'", "it has: 1, 2, 3, 4, 5", "by their number"),
    ),
    "column missing": (paths("range", "rang"), ("paths.csv", "no column 'range'", "did you mean 'rang'")),
    "column twice": (
        paths("t,tx,range,az,snr", "t,tx,range,range,snr"),
        ("paths.csv", "two columns", "'range'", "rename"),
    ),
    "text in a number column": (paths("53,0.5", "far,0.5"), ("paths.csv", "'range', row 3", "line 5", "'far'")),
    "decimal commas": (
        put("wheels.csv", "t;v;w\n0,0;1,0;0,1\n0,1;1,0;0,1\n"),
        ("wheels.csv", "line 2", "'0,0' is not a number", "decimal points"),
    ),
    "ragged line": (paths("54,0.5,6", "54,0.5,6,7"), ("paths.csv", "line", "header")),
    "not UTF-8": (new_paths(b"t,tx,range,az,snr\n0,\xff\xfe,1,1,1\n"), ("paths.csv", "UTF-8")),
    "header not UTF-8": (new_paths(b"t,tx,r\xff,az,snr\n0,1,1,1,1\n"), ("paths.csv", "UTF-8")),
    "all lines too long": (
        new_paths("t,tx,range,az,snr\n0.1,1,50,0.5,9,7\n0.2,2,51,0.5,9,7\n"),
        ("paths.csv", "longer than the header"),
    ),
    "infinite distance": (paths("53,0.5", "inf,0.5"), ("measurements.distance_m, row 3", "NaN")),
    "placeholder": (paths("53,0.5", "-9999,0.5"), ("measurements.distance_m, row 3", "-9999", "missing value")),
    "degrees": (paths("52,0.5", "52,28.6"), ("azimuth_rad, row 2", "degrees")),
    "link not in the table": (paths("0.3,2", "0.3,7"), ("paths.csv", "row 3", "link '7'", "[links.7]")),
    "duplicate rows": (
        paths("0.3,2,53,0.5,7\n", "0.3,2,53,0.5,7\n0.3,2,53,0.5,7\n"),
        ("measurements, row 4", "repeats", "remove"),
    ),
    "unsorted odometry": (wheels("0.10,", "0.60,"), ("odometry.time_s, row 3", "sort")),
    "odometry of one row": (put("wheels.csv", "t,v,w\n0,1,0\n"), ("odometry", "two rows")),
    "not a .mat file": (mat(b"MATLAB 5.0 MAT-file" + b"\0" * 60), ("gnss.mat", "MATLAB", "export it again")),
    "truncated .mat file": (
        mat(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\x0e\0\0\0\xff\0\0\0"),
        ("gnss.mat", "MATLAB"),
    ),
    "unsorted reference": (put("gnss.csv", "t,x,y\n0,0,0\n2,2,0\n1,1,0\n"), ("reference.time_s, row 2", "sort")),
}


def made(folder: Path) -> Path:
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_campaign(kind: str, tmp_path: Path, cellslam: Run) -> None:
    change, words = BROKEN[kind]
    folder = made(tmp_path / "c")
    change(folder)
    before = sorted(tmp_path.rglob("*"))
    refused(cellslam("import", folder, "--out", tmp_path / "out.h5"), str(folder), *words)
    assert sorted(tmp_path.rglob("*")) == before


def test_files_outside_the_folder_are_named(tmp_path: Path, cellslam: Run) -> None:
    folder = made(tmp_path / "c")
    toml("gnss.csv", "../gnss.csv")(folder)
    (folder / "gnss.csv").rename(tmp_path / "gnss.csv")
    (folder / "wheels.csv").rename(tmp_path / "elsewhere.csv")
    (folder / "wheels.csv").symlink_to(tmp_path / "elsewhere.csv")
    done = cellslam("import", folder, "--out", tmp_path / "out.h5")
    assert done.status == 0 and f"files outside {folder} were read: wheels.csv, ../gnss.csv\n" in done.err


def virtual(file: h5py.File, other: Path) -> h5py.Dataset:
    layout = h5py.VirtualLayout((3,), np.float64)
    layout[:] = h5py.VirtualSource(other, "x", (3,))
    return file.create_virtual_dataset("hidden", layout)


def link(path: Path, other: Path) -> None:
    with h5py.File(path, "w") as file:
        file["x"] = h5py.ExternalLink(other, "/x")


def linked(path: Path, other: Path) -> None:
    with h5py.File(path, "w") as file:
        virtual(file, other)


def unlinked(path: Path, other: Path) -> None:
    """No link leads to the data set, but a cell does; by its count of links, changed from 1 to 2, it is still there."""
    with h5py.File(path, "w") as file:
        hidden = virtual(file, other)
        file.create_dataset("x", data=[hidden.ref], dtype=h5py.ref_dtype)
        header = h5py.h5o.get_info(hidden.id).addr
    content = bytearray(path.read_bytes())
    assert content[header + 4] == 1
    content[header + 4] = 2
    path.write_bytes(content)
    with h5py.File(path, "r+") as file:
        del file["hidden"]


@pytest.mark.parametrize(
    ("point", "text"), [(link, "link into the file"), (linked, "virtual data set"), (unlinked, "virtual data set")]
)
def test_matlab_files_that_point_elsewhere_are_refused(
    point: Callable[[Path, Path], None], text: str, tmp_path: Path
) -> None:
    path, other = tmp_path / "a.mat", tmp_path / "b.mat"
    with h5py.File(other, "w") as file:
        file["x"] = np.arange(3.0)
    point(path, other)
    with pytest.raises(InputError, match=rf"a\.mat: .*{text}"):
        variables(path)


def test_a_file_of_a_campaign_that_points_elsewhere_is_refused(tmp_path: Path) -> None:
    link(tmp_path / "a.h5", tmp_path / "b.h5")
    with pytest.raises(InputError, match=r"a\.h5: .*link into the file"), opened(tmp_path / "a.h5", {}):
        pass


def test_what_crashes_or_stalls_scipy_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mat"
    path.touch()
    monkeypatch.setattr(matlab, "_READ", "import os; os.abort()")
    with pytest.raises(InputError, match=r"a\.mat: damaged: SciPy crashes on it \(SIGABRT\); export it again"):
        variables(path)
    monkeypatch.setattr(matlab, "_READ", "import time; time.sleep(60)")
    monkeypatch.setattr(matlab, "LIMIT_S", 0.3)
    with pytest.raises(InputError, match="it was not read in 0 s"):
        variables(path)


def test_what_crashes_or_stalls_the_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    import_folder(made(tmp_path / "c")).save(path)
    monkeypatch.setattr(recording_guard, "_READ_THROUGH", "import os; os.abort()")
    recording_guard.check(path)  # as it was written: nothing to find out
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(InputError, match=r"a.h5: damaged: the HDF5 library crashes on it .* copy it again"):
        Recording.load(path, accept_changed=True)
    monkeypatch.setattr(recording_guard, "_READ_THROUGH", "import time; time.sleep(60)")
    with pytest.raises(InputError, match="did not get through it in 0 s"):
        recording_guard.check(path, accept_changed=True, limit_s=0.3)


@pytest.mark.slow
@settings(
    max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_values_in_an_hdf5_file_are_refused_in_one_line(data: st.DataObject, tmp_path: Path) -> None:
    """With a seal that is right: what `python -m tools fuzz` damages is found by the seal."""
    path, sound = tmp_path / "a.h5", tmp_path / "sound.h5"
    if not sound.exists():
        import_folder(made(tmp_path / "c")).save(sound)
    path.write_bytes(sound.read_bytes())
    tables = (
        "time_s odometry measurements/snapshot measurements/link measurements/distance_m links/site reference/time_s"
    )
    with resealed(path) as file:
        column = file[data.draw(st.sampled_from(tables.split()))]
        values = column[()]
        flat = values.reshape(-1)
        extreme = (
            st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1.0])
            if values.dtype.kind == "f"
            else st.integers(-(2**62), 2**62)
        )
        for _ in range(data.draw(st.integers(1, 3))):
            flat[data.draw(st.integers(0, len(flat) - 1))] = data.draw(extreme)
        column[...] = values
    try:
        Recording.load(path)
    except InputError as error:
        assert "\n" not in str(error)


def test_a_hundred_thousand_rows_are_read(tmp_path: Path) -> None:
    folder = made(tmp_path / "c")
    rows = 100_000
    t = 0.01 * (np.arange(rows) // 20)
    table = np.column_stack(
        [t, 1 + np.arange(rows) % 2, 50 + 0.01 * np.arange(rows), np.full(rows, 0.5), np.full(rows, 9.0)]
    )
    with (folder / "paths.csv").open("w") as file:
        file.write("t,tx,range,az,snr\n")
        np.savetxt(file, table, "%.6g", ",")
    assert len(import_folder(folder).measurements) == rows
