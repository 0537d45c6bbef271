"""One campaign in every form in which tables come: all give the same recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from cellslam.recordings.importing.importing import import_folder
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

MANIFEST = """
plane = true
[measurements]
file = "log"
columns.time_s = {column = "t", unit = "s"}
columns.distance_m = {column = "range", unit = "m"}
columns.azimuth_rad = {column = "az", unit = "rad"}
[start]
source = "origin"
[sites.link]
clock_offset_std_m = 0
"""
NAMES = ("t", "range", "az")
TABLE = np.array([[1248272272.841, 5.25, 0.5], [1248272273.0, 7.0, -1.5], [1248272273.25, 3.5, 0.125]])


def rows(separator: str) -> str:
    return "".join(separator.join(f"{value!r}" for value in row.tolist()) + "\n" for row in TABLE)


def text(head: str, body: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(head + body) and None


def matrix(**variables: object) -> Callable[[Path], None]:
    return lambda path: savemat(path, variables)


def columns(first: str, *others: str) -> dict[str, str]:
    return dict(zip(NAMES, (first, *others), strict=True))


NUMBERS = columns("1", "2", "3")
KINDS: dict[str, tuple[str, Callable[[Path], None], dict[str, str], str]] = {
    "commas": ("log.csv", text("t,range,az\n", rows(",")), {}, ""),
    "semicolons": ("log.csv", text("t;range;az\n", rows(";")), {}, ""),
    "tabs, a name with a space": ("log.txt", text("t\tthe range\taz\n", rows("\t")), {"range": "the range"}, ""),
    "white space": ("log.txt", text("  t range   az\n", rows("   ").replace("\n", "  \n")), {}, ""),
    "comments, names in the last": ("log.dat", text("# a park\n#\n# t range az\n", rows(" ")), {}, ""),
    "comments that name nothing": ("log.dat", text("# Time [s]  range [m]  bearing [rad]\n", rows(" ")), NUMBERS, ""),
    "a comment in between": ("log.dat", text("", rows(" ").replace("\n", "\n# pause\n\n")), NUMBERS, ""),
    "a matrix": ("log.mat", matrix(log=TABLE), NUMBERS, 'variable = "log"\n'),
    "a matrix in a struct": ("log.mat", matrix(drive={"log": TABLE, "n": 3.0}), columns("log:1", "log:2", "log:3"),
                             'variable = "drive"\n'),
    "vectors and a matrix": ("log.mat", matrix(t=TABLE[:, 0], polar=TABLE[:, 1:]), columns("t", "polar:1", "polar:2"),
                             ""),
}  # fmt: skip


def imported(folder: Path, kind: str) -> Recording:
    name, write, named, more = KINDS[kind]
    manifest = MANIFEST.replace('file = "log"\n', f'file = "{name}"\n{more}')
    for ours, theirs in named.items():
        manifest = manifest.replace(f'"{ours}"', f'"{theirs}"')
    (folder / "recording.toml").write_text(manifest)
    write(folder / name)
    return import_folder(folder)


@pytest.mark.parametrize("kind", KINDS)
def test_every_form_gives_the_same(kind: str, tmp_path: Path) -> None:
    r = imported(tmp_path, kind)
    assert np.array_equal(r.time_s, TABLE[:, 0])
    assert np.array_equal(r.measurements.distance_m, TABLE[:, 1])
    assert np.array_equal(r.measurements.azimuth_rad, TABLE[:, 2])


def test_a_fault_is_named_by_its_line_whatever_stands_before(tmp_path: Path) -> None:
    imported(tmp_path, "a comment in between")
    path = tmp_path / "log.dat"
    path.write_text(path.read_text().replace("7.0", "far"))
    with pytest.raises(InputError, match=r"column '2', row 1 \(line 4\): 'far' is not a number"):
        import_folder(tmp_path)
    path.write_text("# nothing but this\n")
    with pytest.raises(InputError, match=r"log\.dat: is empty"):
        import_folder(tmp_path)
