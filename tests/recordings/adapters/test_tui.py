"""The layout of TU Ilmenau's campaigns, written from a simulated drive: paths given, or found in the responses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.tui_files import NAME, load_sheet, opened
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation
from cellslam.sim.lte.array import CircularArray
from cellslam.sim.recording import Recording

CARRIER_HZ, TONES = 2.53e9, 2.53e9 + 78_125.0 * (np.arange(257) - 128)
SOURCES = np.array([[180.0, 60.0, 30.0], [-120.0, 150.0, 25.0], [60.0, -200.0, 20.0]])
OFFSET_M, ARRAY_TURN, GRID_START = 40.0, np.radians(25.0), -np.pi
SHEET = """
clock_offset_std_m = 100
odometry = "simulated"
[location]
std_m = 0.05
yaw = { dataset = "RotZ", sign = -1, zero_deg = 90 }
"""
PATHS = """
[paths]
file = "Results_CRB_withModelError.h5"
azimuth = { dataset = "AzimuthRx", sign = -1, zero_deg = 0 }
elevation = { dataset = "CoElevationRx", sign = -1, zero_deg = 90 }
"""
RESPONSES = """
[responses]
array = "ArrayRx.h5"
array_azimuth = { sign = 1, zero_deg = 25 }
tx_ports = [4, 2]
port_interval_s = 0
"""


def dataset(group: Any, place: str, values: Any, unit: str = "", labels: tuple[str, ...] = ()) -> None:
    out = group.create_dataset(place, data=values)
    out.attrs["BaseUnit"], out.attrs["UnitScaler"] = unit, 1.0
    for dimension, label in zip(out.dims, labels, strict=False):
        dimension.label = label


def compound(values: np.ndarray) -> np.ndarray:
    out = np.empty(values.shape, [("real", np.float32), ("imag", np.float32)])
    out["real"], out["imag"] = values.real, values.imag
    return out


def path_geometry(drive: Any, at: np.ndarray) -> np.ndarray:
    """Return distance, azimuth and elevation (n, 3, 3) of every source from poses, in the vehicle's frame."""
    poses = drive.poses[at]
    towards = SOURCES[None] - np.column_stack([poses[:, :2], np.full(len(at), 1.8)])[:, None]
    azimuth, elevation = azimuth_elevation(towards)
    return np.stack([np.linalg.norm(towards, axis=2), azimuth - poses[:, 2:], elevation], axis=2)


def write_location(folder: Path, drive: Any) -> None:
    """Write poses at 10 Hz: a local frame, a compass heading in degrees."""
    at = np.arange(0, len(drive.time_s), 5)
    with h5py.File(folder / "LocationRx.h5", "w") as file:
        group = file.create_group("PoseData")
        for axis, values in zip("XYZ", (*drive.poses[at, :2].T, np.full(len(at), 1.8)), strict=True):
            dataset(group, f"Pos{axis}", values, "m")
        dataset(group, "RotZ", 90.0 - np.degrees(drive.poses[at, 2]), "deg")
        dataset(group, "MetaData/Snapshot/TimeStamp", 1.4e9 + drive.time_s[at], "s")


def write_paths(folder: Path, drive: Any, at: np.ndarray) -> np.ndarray:
    """Write the authors' estimates with noise, a list a snapshot, angles in their own senses; return what is true."""
    rng = np.random.default_rng(2)
    true = path_geometry(drive, at)
    measured = true + [0.5, 0.01, 0.01] * rng.standard_normal(true.shape)
    nested = h5py.vlen_dtype(np.float64)
    with h5py.File(folder / "Results_CRB_withModelError.h5", "w") as file:
        group = file.create_group("Results")
        dataset(group, "MetaData/Snapshot/TimeStamp", 1.4e9 + drive.time_s[at], "s")
        columns = {
            "Delay": ((measured[..., 0] + OFFSET_M) / SPEED_OF_LIGHT_MPS, "s"),
            "AzimuthRx": (-measured[..., 1], "rad"),
            "CoElevationRx": (0.5 * np.pi - measured[..., 2], "rad"),
        }
        for name, (values, unit) in columns.items():
            out = group.create_dataset(name, (len(at),), nested)
            out.attrs["BaseUnit"], out.attrs["UnitScaler"] = unit, 1.0
            for row, seen in enumerate(values):
                out[row] = seen[: 3 if row != 1 else 0]  # nothing was found in one of them
    return true


def write_responses(folder: Path, drive: Any, at: np.ndarray) -> None:
    """Write patterns and frequency responses of an array that is turned on the car; three Tx ports, noise."""
    rng = np.random.default_rng(3)
    array = CircularArray(columns=8, rings=2, radius_m=0.09, carrier_hz=CARRIER_HZ)
    ports = 1 + rng.permutation(array.ports)
    azimuth = GRID_START + 2.0 * np.pi * np.arange(32) / 32
    elevation = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 51)
    grid = np.meshgrid(elevation, azimuth, indexing="ij")
    pattern = array.steer(grid[1].ravel(), grid[0].ravel()).value.reshape(51, 32, array.ports, 2)
    with h5py.File(folder / "ArrayRx.h5", "w") as file:
        group = file.create_group("BeampatternData")
        shuffled = rng.permutation(array.ports)
        values = pattern[:, :, shuffled].transpose(0, 1, 3, 2)[:, :, None]
        labels = ("Elevation", "Azimuth", "Frequency", "RefPolarization", "Port")
        dataset(group, "Data", compound(values), "", labels)
        dataset(group, "MetaData/Azimuth/AzimuthAngle", np.degrees(azimuth), "deg")
        dataset(group, "MetaData/Elevation/ElevationAngle", np.degrees(elevation), "deg")
        dataset(group, "MetaData/Frequency/Frequency", [CARRIER_HZ], "Hz")
        dataset(group, "MetaData/Port/AntennaPortID", ports[shuffled])
    data = 0.05 * (rng.standard_normal((3, 32, 257, len(at), 2)) @ [1.0, 1j])
    for k, paths in enumerate(path_geometry(drive, at)):
        steering = array.steer(paths[:, 1] - ARRAY_TURN, paths[:, 2]).value
        delays = np.exp(-2j * np.pi * np.outer((paths[:, 0] + OFFSET_M) / SPEED_OF_LIGHT_MPS, TONES))
        for tx in (1, 2):  # the first Tx port reaches nobody
            weights = np.exp(2j * np.pi * rng.random((3, 2)))
            data[tx, :, :, k] += np.einsum("npq,nq,nf->pf", steering, weights, delays)
    with h5py.File(folder / "FrequencyResponses.h5", "w") as file:
        group = file.create_group("FrequencyResponses")
        dataset(group, "Data", compound(data), "", ("Tx", "Rx", "Frequency", "Snapshot"))
        dataset(group, "MetaData/Frequency/Frequency", TONES / 1e9)
        file["FrequencyResponses/MetaData/Frequency/Frequency"].attrs.update({"BaseUnit": "Hz", "UnitScaler": 1e9})
        dataset(group, "MetaData/Snapshot/TimeStamp", 1e9 * (1.4e9 + drive.time_s[at]))
        file["FrequencyResponses/MetaData/Snapshot/TimeStamp"].attrs.update({"BaseUnit": "s", "UnitScaler": 1e-9})
        dataset(group, "MetaData/Tx/AntennaPortID", [7, 2, 4])
        dataset(group, "MetaData/Rx/AntennaPortID", ports)


@pytest.fixture(scope="module")
def drive(drive_eights: Callable[..., Any]) -> Any:
    return drive_eights(120.0, 1.5, 0.1)


def imported(folder: Path, sheet: str) -> Recording:
    (folder / "tui.toml").write_text(sheet)
    return import_adapter(folder, "tui")


def test_paths_of_the_authors(drive: Any, tmp_path: Path, position_rmse: Callable[..., float]) -> None:
    at = np.arange(0, len(drive.time_s), 10)
    write_location(tmp_path, drive)
    true = write_paths(tmp_path, drive, at)
    with h5py.File(tmp_path / "LocationTx.h5", "w") as file:
        for axis, value in zip("XYZ", SOURCES[0], strict=True):
            dataset(file.create_group("PoseData") if axis == "X" else file["PoseData"], f"Pos{axis}", 5 * [value], "m")
    r = imported(tmp_path, SHEET + PATHS + "[transmitter]\n")
    assert r.sites.position_m is not None and np.array_equal(r.sites.position_m, SOURCES[:1])
    m = r.measurements
    assert len(r.time_s) == len(at) and len(m) == 3 * len(at) - 3 and "simulated" in r.provenance["description"]
    seen = true.reshape(-1, 3)[np.r_[0:3, 6 : 3 * len(at)]]
    assert np.abs(m.distance_m - OFFSET_M - seen[:, 0]).max() < 2.5
    assert np.abs(np.sin(m.azimuth_rad - seen[:, 1])).max() < 0.05 and np.abs(m.elevation_rad - seen[:, 2]).max() < 0.05
    assert np.all(np.cos(m.azimuth_rad - seen[:, 1]) > 0.9)
    assert r.start_pose[3] == pytest.approx(0.3, abs=0.01) and position_rmse(r, "dead-reckoning") < 5.0


def test_paths_found_in_frequency_responses(drive: Any, tmp_path: Path) -> None:
    at = np.array([0, 700])
    write_location(tmp_path, drive)
    write_responses(tmp_path, drive, at)
    r = imported(tmp_path, SHEET + RESPONSES)
    m, true = r.measurements, path_geometry(drive, at)
    assert r.links.port.tolist() == [0, 1] and np.allclose(r.time_s, 1.4e9 + drive.time_s[at])
    for snapshot in range(len(at)):
        for link in range(2):
            rows = (m.snapshot == snapshot) & (m.link == link)
            assert rows.sum() == 3
            for distance, azimuth, elevation in true[snapshot]:
                row = np.flatnonzero(rows)[np.argmin(np.abs(m.distance_m[rows] - OFFSET_M - distance))]
                assert m.distance_m[row] - OFFSET_M == pytest.approx(distance, abs=0.3)
                assert abs(np.angle(np.exp(1j * (m.azimuth_rad[row] - azimuth)))) < 0.02
                assert m.elevation_rad[row] == pytest.approx(elevation, abs=0.03)
    assert m.azimuth_std_rad is not None and np.all((m.azimuth_std_rad > 0) & (m.azimuth_std_rad < 0.02))


@pytest.mark.parametrize(
    ("sheet", "text"),
    [
        (SHEET + PATHS, "its unit is 'gon'"),
        (SHEET + PATHS.replace("AzimuthRx", "Azimuth"), "has no data set 'Results/Azimuth'"),
        (SHEET.replace("clock_offset_std_m = 100\n", "") + PATHS, "clock_offset_std_m"),
        (SHEET + PATHS.replace("sign = -1, zero_deg = 0 ", "sign = -1 "), "zero_deg"),
        (SHEET.split("[location]")[0] + PATHS, "odometry = 'simulated' needs [location] with its yaw"),
        (SHEET.split("[location]")[0].replace("simulated", "none") + PATHS + "[transmitter]\n", "needs [location]"),
    ],
)
def test_what_is_unknown_is_asked(drive: Any, tmp_path: Path, sheet: str, text: str) -> None:
    write_location(tmp_path, drive)
    write_paths(tmp_path, drive, np.arange(0, 200, 50))
    if "gon" in text:
        with h5py.File(tmp_path / "LocationRx.h5", "r+") as file:
            file["PoseData/RotZ"].attrs["BaseUnit"] = "gon"
    with pytest.raises(InputError) as refused:
        imported(tmp_path, sheet)
    assert text in str(refused.value)


def test_dimensions_without_labels_are_named_in_the_sheet(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.zeros((2, 3))
    with opened(tmp_path / "a.h5", {}) as container:
        assert container.axes("x", ("Tx", "Rx")) == ("Tx", "Rx")
        with pytest.raises(InputError, match="x has 2 dimensions without labels; name them in the sheet"):
            container.axes("x")


def test_the_sheet_of_the_page(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "reference" / "data" / "tui.md").read_text("utf-8")
    text = page.split("```toml\n")[1].split("```")[0]
    (tmp_path / NAME).write_text(text)
    assert load_sheet(tmp_path).responses is not None
