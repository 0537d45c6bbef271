"""Import of tables: units, signs, zeros, clocks, lever arms, projections; round trips through every format."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from cellslam.recordings.exporting.tables import write_tables
from cellslam.recordings.importing.campaign import Campaign, build
from cellslam.recordings.importing.importing import import_folder
from cellslam.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import CLOCK_PRIOR, Recording, Reference

Toy = Callable[..., Recording]

MANIFEST = """
description = "courtyard"
[measurements]
file = "paths.csv"
clock = "sounder"
link = {column = "tx"}
sample_rate_hz = 100e6
std = {distance_m = 0.5, azimuth_deg = 2.0}
[measurements.columns]
time_s = {column = "t", unit = "ms"}
distance_m = {column = "tau", unit = "ns"}
azimuth_rad = {column = "doa", unit = "deg", sign = -1, zero = 90}
[clocks.sounder]
offset_s = 10.0
drift_ppm = 100.0
[odometry]
file = "wheels.csv"
hold = "before"
axes = "forward-right-down"
[odometry.columns]
time_s = {column = "t", unit = "s"}
u_x = {column = "v", unit = "km/h"}
u_psi = {column = "w", unit = "deg/s"}
[noise.u_x]
noise_density = 0.1
[noise.u_psi]
noise_density = 0.01
[start]
source = "given"
position_m = [1.0, 2.0, 3.0]
yaw_deg = 90.0
[links.a]
site = "north"
[links.b]
site = "south"
cell_id = 7
port = 1
[sites.north]
clock_offset_std_m = 0.0
[sites.south]
clock_offset_std_m = 30.0
"""
PATHS = "t,tx,tau,doa\n0,b,100,80\n0,a,200,-10\n1000,a,210,\n2000,a,,5\n"
WHEELS = "t,v,w\n" + "".join(f"{t},36,-9\n" for t in (10.0, 11.0001, 12.0002))


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    folder = tmp_path / "campaign"
    folder.mkdir()
    (folder / "recording.toml").write_text(MANIFEST)
    (folder / "paths.csv").write_text(PATHS)
    (folder / "wheels.csv").write_text(WHEELS)
    return folder


def test_units_signs_zeros_clocks_by_hand(campaign: Path) -> None:
    r = import_folder(campaign)
    m = r.measurements
    assert r.time_s == pytest.approx([10.0, 11.0001, 12.0002], abs=1e-12)
    assert m.snapshot.tolist() == [0, 0, 1, 2] and m.link.tolist() == [0, 1, 0, 0]
    ns = SPEED_OF_LIGHT_MPS * 1e-9
    assert m.distance_m[:3] == pytest.approx([200 * ns, 100 * ns, 210 * ns])
    assert np.isnan(m.distance_m[3]) and np.isnan(m.azimuth_rad[2])
    assert np.degrees(m.azimuth_rad[[0, 1, 3]]) == pytest.approx([100.0, 10.0, 85.0])
    assert m.azimuth_std_rad is not None and np.degrees(m.azimuth_std_rad) == pytest.approx([2.0] * 4)
    assert r.odometry[1:, 0] == pytest.approx([10.0, 10.0])
    assert np.degrees(r.odometry[1:, 3]) == pytest.approx([9.0, 9.0])  # clockwise seen from above in its own axes
    assert r.links.cell_id.tolist() == [-1, 7] and r.sites.name == ("north", "south")
    assert r.sites.clock_offset_std_m.tolist() == [0.0, 30.0]
    assert r.start_pose == pytest.approx([1, 2, 3, np.pi / 2, 0, 0])
    assert r.odometry_model.noise_density.tolist() == [0.1, 0, 0, 0.01, 0, 0]


def test_surveyed_sites_and_sectors(campaign: Path, tmp_path: Path) -> None:
    """North is surveyed, with a height that is hardly known; its antenna points to the south-west."""
    survey = "[sites.north]\nposition_m = [10.0, 20.0, 30.0]\nposition_std_m = [0.5, 0.5, 5.0]"
    text = MANIFEST.replace("[sites.north]", survey).replace('site = "north"', 'site = "north"\nazimuth_deg = 225')
    (campaign / "recording.toml").write_text(text)
    r = import_folder(campaign)
    r.save(tmp_path / "north.h5")
    write_tables(r, tmp_path / "again", "csv")
    for made in (r, Recording.load(tmp_path / "north.h5"), import_folder(tmp_path / "again")):
        assert made.sites.surveyed_m[0].tolist() == [10.0, 20.0, 30.0] and np.isnan(made.sites.surveyed_m[1]).all()
        assert made.sites.survey_std_m.tolist() == [[0.5, 0.5, 5.0], [0.0, 0.0, 0.0]]
        azimuth = np.degrees(np.asarray(made.links.azimuth_rad))
        assert azimuth == pytest.approx([-135.0, np.nan], nan_ok=True)
    (campaign / "recording.toml").write_text(text.replace("position_m = [10.0, 20.0, 30.0]", ""))
    with pytest.raises(InputError, match=r"\[sites.north\]: position_std_m without position_m"):
        import_folder(campaign)
    half = dataclasses.replace(r.sites, position_m=np.array([[1.0, 2.0, np.nan], [1.0, 2.0, 3.0]]))
    with pytest.raises(InputError, match=r"sites.position_m, row 0: is known in part: write x, y and z"):
        dataclasses.replace(r, sites=half)


@pytest.mark.parametrize(
    ("surveys", "message"),
    [({"roof": (0, 0, 0)}, "site_surveys: 'roof' is no site of a link"), ({"site": (0, 0)}, "'site' has 2 numbers")],
)
def test_impossible_surveys_are_refused(surveys: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build(Campaign([0.0], {"distance_m": [1.0]}, start_pose=(0,) * 6, site_surveys=surveys))


def test_a_reference_is_moved_from_its_antenna_to_the_array(campaign: Path) -> None:
    """The array 2 m before and 1 m left of the GNSS antenna, which looks east, then north."""
    (campaign / "total.csv").write_text("t,e,n,yaw\n10,5,6,0\n12,7,8,90\n")
    (campaign / "recording.toml").write_text(
        MANIFEST
        + """
[reference]
file = "total.csv"
lever_arm_m = [2.0, 1.0, 0.0]
[reference.columns]
time_s = {column = "t", unit = "s"}
x_m = {column = "e", unit = "m"}
y_m = {column = "n", unit = "m"}
yaw_rad = {column = "yaw", unit = "deg"}
"""
    )
    reference = import_folder(campaign).reference
    assert reference is not None
    assert reference.position_m[:, :2] == pytest.approx(np.array([[7.0, 7.0], [6.0, 10.0]]))


REFERENCE = """
[reference]
file = "gnss.csv"
crs = "EPSG:32633"
[reference.columns]
time_s = {column = "t", unit = "s"}
latitude_rad = {column = "lat", unit = "deg"}
longitude_rad = {column = "lon", unit = "deg"}
yaw_rad = {column = "heading", unit = "deg", sign = -1, zero = 90}
"""


def test_latitude_and_longitude_are_projected(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyproj", reason="extra gnss")
    # On the central meridian of zone 33 a degree of longitude to the east is east, and the scale is 0.9996.
    (campaign / "gnss.csv").write_text("t,lat,lon,heading\n10,55.0,15.0,0\n11,55.001,15.0,0\n12,55.0,15.001,90\n")
    (campaign / "recording.toml").write_text(MANIFEST + REFERENCE)
    reference = import_folder(campaign).reference
    assert reference is not None
    # WGS 84: a degree of latitude at 55 deg is 111 323.6 m, of longitude 63 994.6 m (radii of curvature).
    assert reference.position_m[0, :2] == pytest.approx([0, 0], abs=1e-6)
    assert reference.position_m[1, :2] == pytest.approx([0.0, 111.3236 * 0.9996], abs=2e-3)
    assert reference.position_m[2, :2] == pytest.approx([63.9946 * 0.9996, 0.0], abs=2e-3)
    assert np.isnan(reference.position_m[:, 2]).all()
    assert reference.yaw_rad == pytest.approx([np.pi / 2, np.pi / 2, 0.0], abs=1e-4)
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(InputError, match=r"pip install 'cellslam\[gnss\]'"):
        import_folder(campaign)


def test_north_east_down_and_poses_of_an_odometry_frame(campaign: Path) -> None:
    text = MANIFEST.replace("[odometry.columns]", 'kind = "poses"\n[odometry.columns]').replace("axes", "# axes")
    text = text.replace(
        'u_x = {column = "v", unit = "km/h"}', 'x_m = {column = "v", unit = "m"}\ny_m = {column = "w", unit = "m"}'
    )
    text = text.replace('u_psi = {column = "w", unit = "deg/s"}', 'yaw_rad = {column = "h", unit = "deg"}')
    (campaign / "wheels.csv").write_text("t,v,w,h\n10,5,5,90\n11.0001,5,7,90\n12.0002,5,8,90\n")
    text += """
[reference]
file = "total.csv"
axes = "north-east-down"
[reference.columns]
time_s = {column = "t", unit = "s"}
x_m = {column = "n", unit = "m"}
y_m = {column = "e", unit = "m"}
z_m = {column = "d", unit = "m"}
"""
    (campaign / "total.csv").write_text("t,n,e,d\n10,1,2,3\n12,4,5,6\n")
    (campaign / "recording.toml").write_text(text)
    r = import_folder(campaign)
    assert r.odometry[1:, 0] == pytest.approx([2.0 / 1.0001, 1.0 / 1.0001])
    assert r.odometry[1:, 1] == pytest.approx([0, 0], abs=1e-12)
    assert r.reference is not None and r.reference.position_m[0].tolist() == [2.0, 1.0, -3.0]


def partial_drive(draw: st.DrawFn, toy: Toy) -> Recording:
    """A drive of any intervals, by any clock, whose odometry pauses and lacks components."""
    pause = st.sampled_from([0.001, 0.1, 0.1, 0.1, 2.0, 70.0])
    steps = np.array(draw(st.lists(pause, min_size=1, max_size=30)))
    made = toy(snapshots=len(steps), truth=False)
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    odometry = made.odometry.copy()
    odometry[1:][rng.random((len(steps) - 1, 6)) < draw(st.sampled_from([0.0, 0.3]))] = np.nan
    odometry[:, draw(st.lists(st.integers(0, 5), unique=True, max_size=6))] = np.nan
    fixes = rng.normal(0.0, 50.0, (len(steps), 3)) + np.where(rng.random((len(steps), 1)) < 0.2, np.nan, 0.0)
    unknown = np.full(len(steps), np.nan)
    time_s = draw(st.sampled_from([0.0, 1.7e9])) + np.cumsum(steps)
    reference = Reference(time_s + 0.03, fixes, unknown, unknown)
    clocks = {name: rng.random(len(made.sites)) for name in CLOCK_PRIOR}
    clocks[CLOCK_PRIOR[-1]] = draw(st.sampled_from([None, clocks[CLOCK_PRIOR[-1]]]))
    sites = dataclasses.replace(made.sites, **clocks)
    return dataclasses.replace(made, time_s=time_s, odometry=odometry, reference=reference, sites=sites)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
@pytest.mark.usefixtures("mat_files_read_here")
@pytest.mark.parametrize("kind", ["csv", "mat"])
def test_a_round_trip_is_a_round_trip(kind: str, toy_recording: Toy, data: st.DataObject) -> None:
    """Times, odometry, measurements, reference, what is known of clocks: all come back to the last digit."""
    drive = partial_drive(data.draw, toy_recording)
    with TemporaryDirectory() as folder:
        write_tables(drive, Path(folder) / "out", kind)
        again = import_folder(Path(folder) / "out")
    assert again.reference is not None and drive.reference is not None
    for name in ("time_s", "odometry"):
        np.testing.assert_array_equal(getattr(again, name), getattr(drive, name))
    reference = dataclasses.replace(again.reference, odometry=None)  # an import makes it of the odometry's table
    for one, two in ((again.measurements, drive.measurements), (reference, drive.reference)):
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name))
    for name in CLOCK_PRIOR:
        np.testing.assert_array_equal(getattr(again.sites, name), getattr(drive.sites, name))


def matlab_73(path: Path, tables: dict[str, dict[str, Any]]) -> None:
    """Write structs of columns as MATLAB 7.3 does: HDF5 with a header block, matrices by columns."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, columns in tables.items():
            group = file.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for column, values in columns.items():
                group[column] = np.atleast_2d(np.asarray(values))  # (1, N) in the file is N x 1 in MATLAB
                group[column].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, made by a test".ljust(512, b" "))


def test_mat_73_is_read_as_mat_5(toy_recording: Toy, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    write_tables(toy_recording(), folder, "mat")
    first = import_folder(folder)
    old = variables(folder / "recording.mat")
    matlab_73(folder / "recording.mat", {name: {k: np.ravel(v) for k, v in old[name].items()} for name in old})
    second = import_folder(folder)
    assert second.measurements.distance_m.tobytes() == first.measurements.distance_m.tobytes()
    assert second.odometry.tobytes() == first.odometry.tobytes()


def test_matlab_names_cells_structs_and_what_is_empty(tmp_path: Path) -> None:
    pair = np.array([(1.0,), (2.0,)], [("x", object)])
    savemat(tmp_path / "old.mat", {"text": np.array(["ab", "cd"]), "pair": pair})
    old = variables(tmp_path / "old.mat")
    assert old["text"] == ["ab", "cd"] and [float(item["x"].item()) for item in old["pair"]] == [1.0, 2.0]
    with pytest.raises(InputError, match=r"no variable 'pairs'.*pair.* \(it has: pair, text\)"):
        variables(tmp_path / "old.mat", ("pairs",))
    with h5py.File(tmp_path / "new.mat", "w") as file:
        for name, kind in (("char", "char"), ("cell", "cell"), ("double", "double")):
            file[name] = np.array([0, 3], np.uint64)
            file[name].attrs.update({"MATLAB_class": np.bytes_(kind), "MATLAB_empty": 1})
        file["name"] = np.array([[ord(letter)] for letter in "drive"], np.uint16)
        file["name"].attrs["MATLAB_class"] = np.bytes_("char")
        file["both"] = np.array([file[place].ref for place in ("name", "char")], h5py.ref_dtype)
    new = variables(tmp_path / "new.mat")
    assert new["char"] == "" and new["cell"] == [] and new["double"].shape == (0, 3)
    assert new["name"] == "drive" and new["both"] == ["drive", ""]


def test_delays_in_samples(campaign: Path) -> None:
    (campaign / "recording.toml").write_text(
        MANIFEST.replace('column = "tau", unit = "ns"', 'column = "tau", unit = "samples"')
    )
    assert import_folder(campaign).measurements.distance_m[1] == pytest.approx(100 * SPEED_OF_LIGHT_MPS / 100e6)
