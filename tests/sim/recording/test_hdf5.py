from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.sim.recording.columns import COLUMNS
from tests.sealing import resealed

Toy = Callable[..., Recording]


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if not dataclasses.is_dataclass(value):
        return {prefix: value}
    out: dict[str, Any] = {}
    for f in dataclasses.fields(value):
        out |= flat(getattr(value, f.name), f"{prefix}.{f.name}")
    return out


def assert_identical(a: Any, b: Any) -> None:
    """Compare two recordings, or parts of them, bit for bit."""
    left, right = flat(a), flat(b)
    assert left.keys() == right.keys()
    for name, value in left.items():
        if isinstance(value, np.ndarray):
            assert value.dtype == right[name].dtype, name
            assert value.tobytes() == right[name].tobytes(), name
        else:
            assert value == right[name], name


@pytest.mark.parametrize("truth", [True, False])
def test_round_trip_is_bit_for_bit(toy_recording: Toy, tmp_path: Path, truth: bool) -> None:
    recording = toy_recording(snapshots=700, truth=truth)
    elevation = recording.measurements.elevation_rad.copy()
    elevation[3], elevation[4] = np.nan, -0.0
    measurements = dataclasses.replace(
        recording.measurements, elevation_rad=elevation, distance_std_m=np.full(len(elevation), 0.1)
    )
    recording = dataclasses.replace(recording, measurements=measurements, provenance={"k": [1, 0.1, None, "Lund å"]})
    recording.save(tmp_path / "a.h5")
    assert_identical(recording, Recording.load(tmp_path / "a.h5"))
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_columns_carry_units_and_plain_types_and_the_bytes_repeat(toy_recording: Toy, tmp_path: Path) -> None:
    toy_recording().save(tmp_path / "a.h5")
    toy_recording().save(tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with h5py.File(tmp_path / "a.h5") as file:
        written = [column for column in COLUMNS if column.path in file]
        assert len(written) > 30
        for column in written:
            assert file[column.path].attrs["unit"] == column.unit
            assert file[column.path].dtype.str in ("<f8", "<i8", "|O"), column.path


def replace(path: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        attributes = dict(file[path].attrs)
        del file[path]
        file[path] = value
        file[path].attrs.update(attributes)

    return change


def assign(path: str, row: int, value: float) -> Callable[[h5py.File], None]:
    return lambda file: file[path].__setitem__(row, value)


BROKEN = {
    "other HDF5": (lambda f: f.attrs.__delitem__("format"), ["not a recording", "cellslam record"]),
    "newer version": (lambda f: f.attrs.__setitem__("schema_version", 99), ["version 99", "reads version 2", "update"]),
    "missing table": (lambda f: f.pop("measurements"), ["table 'measurements' is missing", "distance_m"]),
    "missing column": (lambda f: f.pop("measurements/snr_db"), ["'measurements/snr_db' is missing", "'dB'"]),
    "misspelled": (
        lambda f: f.__setitem__("measurements/distance_sd_m", np.zeros(3)),
        ["distance_sd_m'", "distance_std_m"],
    ),
    "unknown table": (lambda f: f.create_group("measurments"), ["'measurments'", "did you mean"]),
    "broken link": (lambda f: f.__setitem__("odd", h5py.SoftLink("/no")), ["'odd'", "broken link"]),
    "numbers for text": (replace("sites/name", np.zeros(2)), ["'sites/name'", "text"]),
    "fractions for indices": (replace("links/site", np.zeros(4)), ["'links/site'", "float64", "integers"]),
    "no unit": (lambda f: f["time_s"].attrs.__delitem__("unit"), ["'time_s' has no unit", "'s'"]),
    "wrong unit": (lambda f: f["time_s"].attrs.__setitem__("unit", "ms"), ["unit 'ms'", "'s'"]),
    "short column": (replace("measurements/link", np.zeros(3, np.int64)), ["(3,)", "measurements/snapshot"]),
    "wrong width": (replace("odometry", np.zeros((40, 5))), ["'odometry'", "(40, 5)", "(T, 6)"]),
    "time not finite": (assign("time_s", 7, np.nan), ["time_s, row 7", "finite"]),
    "time backwards": (assign("time_s", 7, 0.1), ["time_s, row 7", "sort"]),
    "unknown link": (assign("measurements/link", 2, 44), ["measurements.link, row 2", "4 links"]),
    "unsorted": (assign("measurements/snapshot", 0, 5), ["measurements, row", "sorted"]),
    "degrees": (assign("measurements/azimuth_rad", 4, 90.0), ["azimuth_rad, row 4", "radians"]),
    "unknown VT": (assign("truth/measurement_vt", 1, 9), ["truth.measurement_vt, row 1", "4 VTs"]),
    "not JSON": (replace("provenance", "{seed"), ["provenance is not JSON"]),
    "not UTF-8": (replace("provenance", np.bytes_(b"\xff\xfe")), ["provenance", "UTF-8"]),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_file_says_what_is_wrong_where(toy_recording: Toy, tmp_path: Path, kind: str) -> None:
    change, words = BROKEN[kind]
    path = tmp_path / "drive.h5"
    toy_recording().save(path)
    with resealed(path) as file:
        change(file)
    with pytest.raises(InputError) as caught:
        Recording.load(path)
    text = str(caught.value)
    assert "drive.h5" in text and "\n" not in text
    for word in words:
        assert word in text


def test_files_that_are_no_hdf5(toy_recording: Toy, tmp_path: Path) -> None:
    path = tmp_path / "drive.h5"
    with pytest.raises(InputError, match=r"drive\.h5: no such file"):
        Recording.load(path)
    with pytest.raises(InputError, match="is a folder"):
        Recording.load(tmp_path)
    toy_recording().save(path)
    cut = path.read_bytes()[:5000]
    for content, text in ((b"time,x,y\n", "not an HDF5 file"), (b"", "not an HDF5 file"), (cut, "damaged, truncated")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"drive\.h5: {text}"):
            Recording.load(path)


def test_no_byte_is_changed_unnoticed(toy_recording: Toy, tmp_path: Path) -> None:
    path, rng = tmp_path / "drive.h5", np.random.default_rng(67)
    toy_recording().save(path)
    sound = path.read_bytes()
    for _ in range(60):
        changed = bytearray(sound)
        for at in rng.integers(len(sound), size=5):
            changed[at] ^= int(rng.integers(1, 256))
        path.write_bytes(changed)
        with pytest.raises(InputError, match=r"drive\.h5"):
            Recording.load(path)


def test_what_was_changed_on_purpose_is_accepted(toy_recording: Toy, tmp_path: Path) -> None:
    path = tmp_path / "drive.h5"
    toy_recording().save(path)
    with h5py.File(path, "r+") as file:
        file["measurements/distance_m"][0] = 77.0
    with pytest.raises(InputError, match=r"SHA-256 is not the one .* --accept-changed"):
        Recording.load(path)
    assert Recording.load(path, accept_changed=True).measurements.distance_m[0] == 77.0


def external_link(file: h5py.File, other: str) -> None:
    del file["time_s"]
    file["time_s"] = h5py.ExternalLink(other, "/time_s")


def virtual(file: h5py.File, other: str) -> None:
    size = file["time_s"].shape
    del file["time_s"]
    layout = h5py.VirtualLayout(size, np.float64)
    layout[:] = h5py.VirtualSource(other, "time_s", size)
    file.create_virtual_dataset("time_s", layout).attrs["unit"] = "s"


def external_storage(file: h5py.File, other: str) -> None:
    size = file["time_s"].shape
    del file["time_s"]
    places = [(other, 0, h5py.h5f.UNLIMITED)]
    file.create_dataset("time_s", size, np.float64, external=places).attrs["unit"] = "s"


@pytest.mark.parametrize(
    ("point", "text"),
    [(external_link, "link into the file"), (virtual, "virtual data set"), (external_storage, "external storage")],
)
@pytest.mark.parametrize("is_sealed", [True, False])
def test_values_in_other_files_are_refused(
    toy_recording: Toy, tmp_path: Path, point: Callable[..., None], text: str, is_sealed: bool
) -> None:
    path, other = tmp_path / "drive.h5", tmp_path / "other.h5"
    for place in (path, other):
        toy_recording().save(place)
    with resealed(path) as file:
        point(file, str(other))
    if not is_sealed:
        with h5py.File(path, "r+") as file:
            file.attrs["changed"] = 1
    with pytest.raises(InputError, match=f"drive.h5: '/time_s' .*{text}"):
        Recording.load(path, accept_changed=True)


def test_a_failed_save_leaves_nothing(toy_recording: Toy, tmp_path: Path) -> None:
    recording = toy_recording()
    with pytest.raises(InputError, match="no folder"):
        recording.save(tmp_path / "missing" / "a.h5")
    (tmp_path / "taken.h5").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        recording.save(tmp_path / "taken.h5")
    with pytest.raises(InputError, match="JSON"):
        dataclasses.replace(recording, provenance={"x": object()}).save(tmp_path / "a.h5")
    assert [p.name for p in tmp_path.iterdir()] == ["taken.h5"]


def test_a_failed_save_keeps_the_old_file(toy_recording: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    toy_recording().save(path)
    before = path.read_bytes()

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cellslam.sim.recording.hdf5._write", full)
    with pytest.raises(InputError, match="No space left"):
        toy_recording(seed=1).save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
