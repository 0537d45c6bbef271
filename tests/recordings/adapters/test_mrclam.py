"""The UTIAS multi-robot layout: written from a simulated drive, imported by the command, driven over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.sim.recording import Recording
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from tests.command_line import Run, refused

BEGIN_S = 1248272272.841
LANDMARKS = {6: (5.5, 3.0), 7: (-2.5, 4.5), 8: (-6.0, -1.5), 9: (0.5, -6.5), 10: (7.0, -4.0), 11: (2.0, 1.5)}
CODES = {1: 5, 2: 14, 3: 41, 4: 32, 5: 23, 6: 72, 7: 27, 8: 54, 9: 70, 10: 36, 11: 18}
MISREAD = 99
# Of this simulation: 0.1 m and one degree, a misreading now and then.
OPTIONS = {
    "noise_floor_m": 0.1,
    "noise_floor_azimuth_deg": 1.0,
    **dict.fromkeys(("noise_unit_snr_m", "noise_unit_snr_azimuth_deg"), 0.0),
    **NOTHING_PERSISTS,
}


def write(folder: Path, drive: Any) -> None:
    """Write a data set of robot 2: commands that are 4 % too fast and turn 0.02 rad/s too little, and noise."""
    rng = np.random.default_rng(3)
    t, poses = drive.time_s, drive.poses

    def table(name: str, head: str, rows: np.ndarray, kinds: str) -> None:
        np.savetxt(folder / name, rows, kinds.split(), "\t", header=f"UTIAS\n{name}\n{head}")

    table("Barcodes.dat", "Subject # Barcode #", np.array(list(CODES.items())), "%d %d")
    places = np.array([(number, x, y, 1e-3, 1e-3) for number, (x, y) in LANDMARKS.items()])
    table("Landmark_Groundtruth.dat", "Subject # x y x-std y-std", places, "%3d %9.5f %9.5f %.7f %.7f")
    commands = np.column_stack([BEGIN_S + t, 1.04 * drive.speed, drive.turn - 0.02])
    commands[:, 1:] += [0.05, 0.05] * rng.standard_normal((len(t), 2))
    table("Robot2_Odometry.dat", "Time v omega", commands, "%.3f %8.5f %8.5f")
    table("Robot2_Groundtruth.dat", "Time x y theta", np.column_stack([BEGIN_S + t, poses]), "%.3f %9.5f %9.5f %9.5f")
    rows = []
    for i in range(0, len(t), 15):
        for code, (x, y) in [(CODES[n], place) for n, place in LANDMARKS.items()] + [(CODES[3], (0.0, 0.02 * t[i]))]:
            dx, dy = x - poses[i, 0], y - poses[i, 1]
            bearing = np.arctan2(dy, dx) - poses[i, 2]
            bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
            if abs(bearing) < 1.0 and rng.random() < 0.8:
                noise = rng.standard_normal(2)
                rows.append((BEGIN_S + t[i], code, np.hypot(dx, dy) + 0.1 * noise[0], bearing + 0.017 * noise[1]))
        if rng.random() < 0.01:
            rows.append((BEGIN_S + t[i], MISREAD, rng.uniform(1.0, 6.0), rng.uniform(-1.0, 1.0)))
    rows.append(rows[-1])  # the sets repeat rows
    table("Robot2_Measurement.dat", "Time Barcode range bearing", np.array(rows), "%.3f %4d %7.3f %7.3f")


@pytest.fixture(scope="module")
def folder(drive_eights: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("MRCLAM_Dataset1")
    write(place, drive_eights(200.0, 0.5, 0.15))
    return place


WORDS = ("--quiet", "import", "--adapter", "mrclam", "--out", "a.h5")
ROBOT = ("--set", "robot=2")


def test_unknown_association(folder: Path, cellslam: Run, position_rmse: Callable[..., float]) -> None:
    assert cellslam(*WORDS, *ROBOT, folder).status == 0
    r = Recording.load("a.h5")
    assert len(r.links) == 1 and r.plane and r.reference is not None
    assert position_rmse(r, "ekf-slam", **OPTIONS) < 0.5 * position_rmse(r, "dead-reckoning")


def test_known_association(folder: Path, cellslam: Run) -> None:
    """Each landmark is a link; neither the other robot nor a misread code is among them, and all stand in place."""
    assert cellslam(*WORDS, *ROBOT, folder, "--set", "association=known").status == 0
    r = Recording.load("a.h5")
    assert r.sites.name == tuple(f"landmark {number}" for number in LANDMARKS)
    m, reference = r.measurements, r.reference
    assert reference is not None
    x, y = (np.interp(r.time_s, reference.time_s, c)[m.snapshot] for c in reference.position_m[:, :2].T)
    yaw = np.interp(r.time_s, reference.time_s, np.unwrap(reference.yaw_rad))[m.snapshot]
    seen = np.column_stack([x, y]) + m.distance_m[:, None] * np.column_stack(
        [np.cos(yaw + m.azimuth_rad), np.sin(yaw + m.azimuth_rad)]
    )
    places = np.array(list(LANDMARKS.values()))[m.link]
    assert np.hypot(*(seen - places).T).max() < 0.6
    assert r.sites.position_m is None
    known = ("--set", "association=known", "--set", "sites=known")
    assert cellslam(*WORDS, *ROBOT, folder, *known).status == 0
    sites = Recording.load("a.h5").sites
    np.testing.assert_allclose(sites.surveyed_m, [(*place, 0.0) for place in LANDMARKS.values()], atol=1e-5)
    np.testing.assert_allclose(sites.survey_std_m, [[1e-3, 1e-3, 0.0]] * len(LANDMARKS))


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("robot=7", "robot = 7: give 1 to 5"),
        ("sites=known", "sites = 'known' needs association = 'known'"),
        ("sites=yes", "sites = 'yes': give 'unknown' or 'known'"),
        ("robots=2", "has no option 'robots'; did you mean 'robot'"),
    ],
)
def test_wrong_options(folder: Path, option: str, text: str, cellslam: Run) -> None:
    refused(cellslam(*WORDS, folder, "--set", option), text)
    refused(cellslam("import", folder, *ROBOT, "--out", "a.h5"), "options of an adapter")
