"""The Plaza layout: ranges to radio beacons and odometry in increments, written from a simulated drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from cellslam.sim.recording import Recording
from tests.command_line import Run, refused

pytestmark = pytest.mark.usefixtures("mat_files_read_here")
BEACONS = {1: (-30.0, 18.0), 6: (12.0, 40.0), 0: (33.0, -5.0), 5: (-8.0, -38.0)}
BEGIN_S, ANTENNA = 3152.0, 2
EVERY = 10  # of the drive's steps: 5 Hz


def tables(drive: Any, turned: bool) -> dict[str, np.ndarray]:
    """Return the matrices of a drive whose odometry drifts; `turned`: GT's heading looks backwards."""
    rng = np.random.default_rng(8)
    at = np.arange(0, len(drive.time_s), EVERY)
    t, poses = BEGIN_S + drive.time_s[at], drive.poses[at]
    yaw = poses[:, 2]
    distance = np.add.reduceat(drive.speed * 0.02, at)[:-1] * 1.01 + 0.02 * rng.standard_normal(len(at) - 1)
    change = np.diff(yaw) + 0.001 * 0.2 + 0.004 * rng.standard_normal(len(at) - 1)
    polled = np.arange(3, len(drive.time_s), 35)
    names = np.array(list(BEACONS))[np.arange(len(polled)) % 4]
    places = np.array([BEACONS[int(name)] for name in names])
    ranges = np.hypot(*(places - drive.poses[polled, :2]).T) + 0.3 * rng.standard_normal(len(polled))
    heard = rng.random(len(polled)) < 0.8
    return {
        "DR": np.column_stack([t[1:], distance, change]),
        "GT": np.column_stack([t, poses[:, :2], yaw + (np.pi if turned else 0.0)]),
        "TD": np.column_stack([BEGIN_S + drive.time_s[polled], np.full(len(polled), ANTENNA), names, ranges])[heard],
        "TL": np.array([(name, *place) for name, place in BEACONS.items()]),
    }


@pytest.fixture(scope="module")
def drive(drive_eights: Callable[..., Any]) -> Any:
    return drive_eights(240.0, 1.5, 0.1)


@pytest.fixture
def imported(cellslam: Run) -> Callable[..., Recording]:
    """Imports a file, or the one of the working directory."""

    def run(place: str = ".", out: str = "a.h5", *words: str) -> Recording:
        assert cellslam("--quiet", "import", place, "--adapter", "plaza", "--out", out, *words).status == 0
        return Recording.load(out)

    return run


@pytest.mark.parametrize("turned", [False, True])
def test_a_mat_file(drive: Any, turned: bool, imported: Any, position_rmse: Callable[..., float]) -> None:
    savemat("Plaza2_.mat", tables(drive, turned))
    r = imported()
    assert sorted(r.sites.name) == ["beacon 0", "beacon 1", "beacon 5", "beacon 6"] and r.plane
    m = r.measurements
    places = np.array([BEACONS[int(name.split()[1])] for name in r.sites.name])[m.link]
    true = drive.at(r.time_s - BEGIN_S)
    assert np.abs(np.hypot(*(places - true[m.snapshot, :2]).T) - m.distance_m).max() < 1.5
    assert np.isnan(m.azimuth_rad).all()
    assert r.start_pose[3] == pytest.approx(true[0, 2], abs=0.05)
    # What the drift of the odometry alone amounts to: lost time, or heading before the step, would be more.
    assert position_rmse(r, "dead-reckoning") < 4.0


def test_beacons_may_be_known(drive: Any, imported: Any, cellslam: Run) -> None:
    made = tables(drive, False)
    savemat("a.mat", made)
    assert imported("a.mat").sites.position_m is None
    sites = imported("a.mat", "a.h5", "--set", "sites=known").sites
    places = [(*BEACONS[int(name.split()[1])], 0.0) for name in sites.name]
    np.testing.assert_array_equal(sites.surveyed_m, places)
    savemat("a.mat", {name: made[name] for name in ("DR", "TD", "GT")})
    words = ("import", "a.mat", "--adapter", "plaza", "--out", "b.h5", "--set", "sites=known")
    refused(cellslam(*words), "has no GT and TL, which say where the beacons stand")


def test_text_files_without_ground_truth(drive: Any, imported: Any) -> None:
    made = tables(drive, False)
    for name in ("DR", "TD"):
        np.savetxt(f"Plaza1_{name}.txt", made[name])
    r = imported()
    assert r.reference is None and np.array_equal(r.start_pose, np.zeros(6))
    savemat("b.mat", made)
    both = imported("b.mat", "b.h5")
    rows = both.time_s >= r.time_s[0]
    assert np.array_equal(both.time_s[rows], r.time_s)
    assert np.allclose(both.odometry[rows][1:], r.odometry[1:], equal_nan=True, atol=1e-9)


@pytest.mark.slow
def test_filters_find_the_beacons(drive: Any, imported: Any, cellslam: Run) -> None:
    """Beacons that are polled in turn, one distance in 0.9 s, without any option."""
    savemat("Plaza1_.mat", tables(drive, False))
    imported()
    names = ("fastslam", "ekf-slam", "bp-slam", "dead-reckoning")
    asked = [word for name in names for word in ("--estimator", name)]
    rows = cellslam("replay", "a.h5", *asked, "--json", "--no-figures").rows
    *filters, alone = (row["position_rmse_m"] for row in rows)
    assert max(filters) < 0.6 * alone  # the scale of range is unknown, and beacons are


def test_folders_that_are_unclear(drive: Any, cellslam: Run) -> None:
    words = ("import", "--adapter", "plaza", "--out", "a.h5")
    refused(cellslam(*words, "."), "holds no file *.mat or *DR.txt")
    made = tables(drive, False)
    for name in ("Plaza1_.mat", "Plaza2_.mat"):
        savemat(name, made)
    refused(cellslam(*words, "."), "more than one file *.mat or *DR.txt (Plaza1_.mat, Plaza2_.mat): leave that of one")
    savemat("Plaza1_.mat", made | {"TD": made["TD"][:, :3]})
    refused(cellslam(*words, "Plaza1_.mat"), "TD has shape")
