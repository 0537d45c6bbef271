"""A recording with traffic: what is blocked is not measured, the truth says by what, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording, Vehicles
from cellslam.sim.traffic import reflecting_vehicle
from cellslam.sim.world import prepare
from tests.sim.recording.test_hdf5 import assert_identical

SHORT = {"vehicle.distance_m": 60.0, "vehicle.duration_s": 60.0, "vehicle.stops": 1}
BUSY = SHORT | {
    "traffic.vehicles_per_km": 60.0, "traffic.bus_share": 0.6, "traffic.lorry_share": 0.2, "traffic.lanes": 3,
    "traffic.oncoming_lanes": 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def busy() -> Recording:
    return simulate("lund-530", 75000, 0, BUSY)


def vehicles(recording: Recording) -> Vehicles:
    assert recording.truth is not None and recording.truth.vehicles is not None
    return recording.truth.vehicles


def seen(intervals: np.ndarray, vts: int, snapshots: int) -> np.ndarray:
    """Return (V, T): which VT is in an interval [..., first, last] at which snapshot."""
    out = np.zeros((vts, snapshots), bool)
    for row in intervals:
        out[row[0], row[-2] : row[-1] + 1] = True
    return out


def test_paths_are_there_or_blocked_and_nothing_else_changes(busy: Recording) -> None:
    empty = simulate("lund-530", 75000, 0, SHORT)
    truth, bare = busy.truth, empty.truth
    assert truth is not None and bare is not None and bare.vehicles is None
    for name in ("position_m", "site", "order", "facets"):
        np.testing.assert_array_equal(getattr(truth.vts, name), getattr(bare.vts, name))
    np.testing.assert_array_equal(busy.odometry, empty.odometry)
    np.testing.assert_array_equal(truth.poses, bare.poses)
    size = len(bare.vts), len(busy.time_s)
    there, free = seen(bare.vts.visible, *size), seen(truth.vts.visible, *size)
    blocked = seen(vehicles(busy).blocked, *size)
    assert blocked.sum() > 50
    assert not (free & blocked).any()
    np.testing.assert_array_equal(free | blocked, there)
    measured = truth.measurement_vt >= 0
    assert free[truth.measurement_vt[measured], busy.measurements.snapshot[measured]].all()


def test_pose_by_pose_gives_the_recording(busy: Recording) -> None:
    world = prepare(load("lund-530", BUSY).world, 75000, 0)
    streams, m = world.streams(), busy.measurements
    _, blocked = world.trace(world.drive.poses[:150], np.arange(150))
    assert len(blocked.path)
    for t in range(150):
        found, _ = world.measure(world.drive.poses[t : t + 1], world.drive.velocity[t : t + 1], t, streams)
        rows = slice(busy.rows[t], busy.rows[t + 1])
        np.testing.assert_allclose(found.measurements.distance_m, m.distance_m[rows], rtol=0.0, atol=1e-9)


def test_file_holds_the_traffic(busy: Recording, tmp_path: Path) -> None:
    busy.save(tmp_path / "a.h5")
    assert len(vehicles(busy)) > 20 and len(vehicles(busy).blocked) > 3
    assert_identical(vehicles(busy), vehicles(Recording.load(tmp_path / "a.h5")))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: {"size_m": -v.size_m}, r"truth.vehicles.size_m, row 0: is not a size"),
        (lambda v: {"blocked": v.blocked + np.array([0, 999, 0, 0])}, "blocked, row 0: is not one of the"),
        (lambda v: {"poses": v.poses[:, :-1]}, "truth/vehicles/poses' has shape"),
    ],
)
def test_a_wrong_table_is_refused(busy: Recording, change: Any, message: str) -> None:
    assert busy.truth is not None
    wrong = replace(vehicles(busy), **change(vehicles(busy)))
    with pytest.raises(InputError, match=message):
        replace(busy, truth=replace(busy.truth, vehicles=wrong))


@pytest.mark.slow
def test_sides_of_lorries_and_buses_reflect() -> None:
    world = prepare(load("lund-530", BUSY | {"traffic.reflect": True}).world, 75000, 0)
    poses, when = world.drive.poses, world.drive.time_s
    paths, blocked = world.trace(poses, np.arange(len(poses)))
    own = reflecting_vehicle(paths.facets)
    rows = np.flatnonzero(own >= 0)
    assert len(rows) > 100 and world.traffic is not None
    site, point, end = world.sites_m[paths.transmitter[rows]], paths.points_m[rows, 0], poses[paths.receiver[rows], :3]
    way = np.linalg.norm(site - point, axis=1) + np.linalg.norm(point - end, axis=1)
    np.testing.assert_allclose(paths.length_m[rows], way, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(paths.vt_position_m[rows] - end, axis=1), way, rtol=1e-12)
    box = world.traffic.at(when[paths.receiver[rows]])[np.arange(len(rows)), own[rows]]
    size = world.traffic.size_m[own[rows]]
    assert (size[:, 0] > 8.0).all()
    c, s, off = np.cos(box[:, 3]), np.sin(box[:, 3]), point - box[:, :3]
    along, across = c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]
    np.testing.assert_allclose(np.abs(across), size[:, 1] / 2, atol=1e-9)
    assert (np.abs(along) <= size[:, 0] / 2 + 1e-9).all()
    assert ((off[:, 2] >= 0.0) & (off[:, 2] <= size[:, 2])).all()
    # Metal: as strong as the direct path, less the longer way.
    np.testing.assert_allclose(
        np.linalg.norm(paths.gain[rows], axis=(1, 2)) * way, np.sqrt(2) * 299792458 / 2.66e9 / (4 * np.pi), rtol=0.02
    )
    assert not (blocked.vehicle == own[blocked.path]).any()
    assert np.isin(blocked.path, rows).any()


def test_what_a_vehicle_reflects_is_clutter() -> None:
    r = simulate("lund-530", 75000, 0, BUSY | {"traffic.reflect": True})
    truth, reflected = r.truth, vehicles(r).reflected >= 0
    assert truth is not None and reflected.sum() > 50
    assert (truth.measurement_vt[reflected] == -1).all()
    assert np.isnan(truth.measurement_std[reflected]).all()
    assert (truth.vts.facets >= -1).all()
    kinds = {vehicles(r).kind[v] for v in vehicles(r).reflected[reflected]}
    assert kinds <= {"lorry", "bus"}
