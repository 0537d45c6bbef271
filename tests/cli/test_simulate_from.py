"""Paths of a ray tracer, exported and fed to the front end: `city trace --format` and `simulate-from`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellslam.cli.main import main
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from tests.command_line import Run, refused

SITES = ("-97.8,150.7,34.1", "17.3,-45.3,32.4")  # those of `tiny`


@pytest.fixture(scope="module")
def own() -> Recording:
    """The drive that `tiny` simulates by itself."""
    return simulate("tiny", 3)


@pytest.fixture(scope="module")
def places(own: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The places of its drive, and the paths to them in both formats."""
    folder = tmp_path_factory.mktemp("paths")
    assert own.truth is not None
    np.savetxt(folder / "rx.csv", own.truth.poses[:, :3], "%.9f", ",", header="x,y,z", comments="")
    words = ["--quiet", "city", "trace", "tiny", "--bs", SITES[0], f"--bs={SITES[1]}", "--rx", str(folder / "rx.csv")]
    for kind, name in (("sionna", "p.npz"), ("deepmimo", "p")):
        assert main([*words, "--format", kind, "--out", str(folder / name)]) == 0
    return folder


@pytest.mark.parametrize(("name", "more"), [("p.npz", ["--polarisation", "VH"]), ("p", [])])
def test_paths_feed_the_front_end(places: Path, own: Recording, name: str, more: list[str], cellslam: Run) -> None:
    assert cellslam("--quiet", "simulate-from", places / name, "tiny", *more, "--out", "a.h5", "--seed", 3).status == 0
    r = Recording.load("a.h5")
    t, m, true = r.truth, r.measurements, own.truth
    assert t is not None and true is not None and len(r.time_s) == len(own.time_s)
    assert np.allclose(t.site_positions_m, true.site_positions_m, atol=1e-4)
    assert np.array_equal(t.clock_offsets_m, true.clock_offsets_m)  # drawn alike
    # It heads where it goes, and as it came where it stands.
    assert np.abs(np.angle(np.exp(1j * (t.poses[:, 3] - true.poses[:, 3])))).max() < np.radians(3.0)
    # What was measured points to where it comes from, in the vehicle's frame.
    real = t.measurement_vt >= 0
    pose = t.poses[m.snapshot[real]]
    towards = t.vts.position_m[t.measurement_vt[real]] - pose[:, :3]
    distance = np.linalg.norm(towards, axis=1) + t.clock_offsets_m[r.links.site[m.link[real]]]
    azimuth = np.angle(np.exp(1j * (np.arctan2(towards[:, 1], towards[:, 0]) - pose[:, 3] - m.azimuth_rad[real])))
    elevation = np.arcsin(towards[:, 2] / np.linalg.norm(towards, axis=1)) - m.elevation_rad[real]
    error = np.column_stack([distance - m.distance_m[real], azimuth, elevation]) / t.measurement_std[real]
    assert np.all(np.median(np.abs(error), axis=0) < 1.0)
    # One coefficient in place of a polarimetric matrix costs some detections.
    assert len(m) == pytest.approx(len(own.measurements), rel=0.02 if more else 0.3)
    assert len(t.vts.order) == len(true.vts.order) and r.provenance["description"] == f"paths of {name}"
    assert np.allclose([site["position_m"] for site in r.provenance["world"]["sites"]], t.site_positions_m)


@pytest.mark.slow
def test_a_recording_of_paths_is_replayed(places: Path, cellslam: Run) -> None:
    words = ("simulate-from", places / "p.npz", "tiny", "--polarisation", "VH", "--out", "a.h5", "--seed", 3)
    assert "400 snapshots" in cellslam(*words, "--set", "vehicle.start_std_m=0.1").err
    (row,) = cellslam("--quiet", "replay", "a.h5", "--estimator", "ekf-slam", "--no-figures", "--json").rows
    assert row["status"] == "ok" and row["bound_position_rmse_m"] > 0.0 and row["position_rmse_m"] < 2.0


def test_a_drive_through_a_grid(places: Path, cellslam: Run) -> None:
    """Places of a drive pick the receivers nearest to them."""
    aside = np.array([0.01, -0.02, 0.3])
    rows = np.loadtxt(places / "rx.csv", delimiter=",", skiprows=1)[20:390:4] + aside
    np.savetxt("along.csv", rows, "%.6f", ",", header="x,y,z", comments="")
    words = ("--quiet", "simulate-from", places / "p", "tiny", "--along", "along.csv", "--out", "a.h5")
    assert cellslam(*words).status == 0
    r = Recording.load("a.h5")
    assert r.truth is not None
    far = [np.linalg.norm(rows - aside - place, axis=1).min() for place in r.truth.poses[:, :3]]
    assert max(far) < 0.1 and 40 < len(far) <= len(rows)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["p", "open"], "has 2 transmitters, the scenario 3 sites (A, B, C)"),
        (["p.npz", "tiny"], "say another --polarisation"),
        (["p", "tiny", "--set", "vehicle.snapshot_interval_s=0.005", "--along", "far.csv"], "be a drive, in order"),
        (["p", "tiny", "--set", "radio.carrier_hz=3.5e9"], "was traced at 2.66e+09 Hz"),
        (["p", "tiny", "--set", "radio.late_probability=0.1"], "--set radio.late_probability=0"),
        (["p", "tiny", "--along", "one.csv"], "has 1 receivers: give those of a drive"),
        (["p", "tiny", "--tolerance", "5,95"], "is out of range: metres above 0"),
        (["p", "tiny", "--tolerance", "wide"], "'wide' is no METRES,DEGREES, as in 5,10"),
        (["nowhere", "tiny"], "no such file or folder; give Sionna RT's paths as .npz, or a DeepMIMO folder"),
    ],
)
def test_what_does_not_fit(places: Path, words: list[str], text: str, cellslam: Run) -> None:
    rows = np.loadtxt(places / "rx.csv", delimiter=",", skiprows=1)[::40]
    for name, kept in (("far.csv", rows), ("one.csv", rows[:1])):
        np.savetxt(name, kept, "%.6f", ",", header="x,y,z", comments="")
    refused(cellslam("simulate-from", places / words[0], *words[1:], "--out", "a.h5", "--quiet"), text)
    assert not Path("a.h5").exists()


def test_formats_ask_for_their_names(places: Path, cellslam: Run) -> None:
    words = ("city", "trace", "tiny", "--bs", SITES[0], "--rx", places / "rx.csv", "--format")
    refused(cellslam(*words, "sionna", "--out", "p.csv"), "writes an .npz")
    refused(cellslam(*words, "deepmimo", "--out", "."), "exists already")
