"""The composed world: recordings that repeat, agree with the single-pose primitive, and carry the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cellslam.sim.recording import Recording, VirtualTransmitters
from cellslam.sim.world import WorldConfig, prepare, simulate
from cellslam.sim.world.drive_to_recording import visible_intervals, with_sites
from cellslam.slam.model.measurement_model import predict
from tests.sim.recording.test_hdf5 import assert_identical


def small_world(**radio: float | bool | str) -> WorldConfig:
    """40 s through a generated city with two sites of two cells."""
    sites = [
        {"name": name, "cells": [{"cell_id": i, "azimuth_deg": a} for i, a in cells]}
        for name, cells in (("A", ((375, 30.0), (376, 150.0))), ("B", ((177, 0.0), (178, 180.0))))
    ]
    return WorldConfig.model_validate(
        {
            "city": {"kind": "procedural", "seed": 3, "extent_m": 400.0, "open_share": 0.9},
            "sites": sites,
            "vehicle": {"route": 5, "distance_m": 40.0, "duration_s": 45.0, "stops": 1},
            "radio": radio,
        }
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(small_world(), 1, 0)


def test_provenance_makes_the_recording_again(recording: Recording) -> None:
    provenance = json.loads(json.dumps(recording.provenance))
    assert provenance["versions"]["cellslam"]
    again = simulate(WorldConfig.model_validate(provenance["world"]), provenance["seed"], provenance["trial"])
    assert_identical(recording, again)


@pytest.mark.parametrize(("seed", "trial"), [(2, 0), (1, 1)])
def test_another_seed_or_trial_differs_but_is_the_same_place(recording: Recording, seed: int, trial: int) -> None:
    other = simulate(small_world(), seed, trial)
    assert recording.truth is not None and other.truth is not None
    assert not np.array_equal(recording.truth.clock_offsets_m, other.truth.clock_offsets_m)
    assert not np.array_equal(recording.odometry, other.odometry)
    np.testing.assert_allclose(recording.start_pose[:2], other.start_pose[:2], atol=1e-6)


def test_known_sites_are_surveyed_with_errors_and_nothing_else_changes(recording: Recording) -> None:
    config = small_world()
    one, other = config.sites
    known = config.model_copy(update={"sites": (one.model_copy(update={"known": True, "survey_std_m": 2.0}), other)})
    made, truth = [simulate(known, 1, trial) for trial in range(4)], recording.truth
    assert truth is not None and recording.sites.position_m is None and recording.links.azimuth_rad is None
    np.testing.assert_array_equal(made[0].measurements.distance_m, recording.measurements.distance_m)
    np.testing.assert_array_equal(made[0].start_pose, recording.start_pose)
    sites, links = made[0].sites, made[0].links
    assert sites.survey_std_m.tolist() == [[2.0] * 3, [0.0] * 3] and np.isnan(sites.surveyed_m[1]).all()
    errors = np.array([r.sites.surveyed_m[0] - r.truth.site_positions_m[0] for r in made if r.truth is not None])
    assert len(np.unique(errors)) == errors.size and 0.7 < np.sqrt(np.mean(errors**2)) < 4.0  # twelve draws
    assert np.degrees(np.asarray(links.azimuth_rad)[::2]) == pytest.approx([30.0, 150.0, np.nan, np.nan], nan_ok=True)
    second = prepare(known, 1, 7, place=0)  # another drive through the place of the first
    np.testing.assert_array_equal(second.surveyed_m, sites.surveyed_m)
    np.testing.assert_array_equal(truth.site_vts >= 0, [True, True])
    np.testing.assert_array_equal(truth.vts.order[truth.site_vts], [0, 0])


def test_without_noise_the_truth_predicts_every_measurement() -> None:
    world = small_world(noise_scale=0.0, clutter_scale=0.0, perfect_detection=True)
    r = simulate(world, 1, 0)
    m, truth = r.measurements, r.truth
    assert truth is not None
    assert len(m) > 1000
    assert (truth.measurement_vt >= 0).all()
    exact = predict(truth.poses[m.snapshot], truth.vts.position_m[truth.measurement_vt])
    exact[:, 0] += truth.clock_offsets_m[r.links.site[m.link]]
    measured = np.stack([m.distance_m, m.azimuth_rad, m.elevation_rad], axis=1)
    np.testing.assert_allclose(measured, exact, atol=1e-9)
    assert abs(truth.clock_offsets_m).min() > 1.0
    # Every path is measured on every link of its site: 2 cells x 2 ports.
    seen = truth.vts.visible
    assert len(m) == 4 * (seen[:, 2] - seen[:, 1] + 1).sum()


def test_without_noise_the_truth_predicts_the_measurements_of_scatterers() -> None:
    r = simulate(small_world(noise_scale=0.0, clutter_scale=0.0, perfect_detection=True, scatterers=3.0), 1, 0)
    m, truth = r.measurements, r.truth
    assert truth is not None and r.scatterers
    vt = truth.measurement_vt
    assert (vt >= 0).all() and truth.vts.scatters[vt].sum() > 1000 and (~truth.vts.scatters[vt]).sum() > 1000
    exact = predict(truth.poses[m.snapshot], truth.vts.position_m[vt])
    to_site = np.linalg.norm(truth.vts.position_m - truth.site_positions_m[truth.vts.site], axis=1)
    exact[:, 0] += np.where(truth.vts.scatters, to_site, 0.0)[vt] + truth.clock_offsets_m[r.links.site[m.link]]
    measured = np.stack([m.distance_m, m.azimuth_rad, m.elevation_rad], axis=1)
    np.testing.assert_allclose(measured, exact, atol=1e-9)
    seen = truth.vts.visible
    assert len(m) == 4 * (seen[:, 2] - seen[:, 1] + 1).sum()
    assert np.unique(np.column_stack([truth.vts.site, truth.vts.facets]), axis=0).shape[0] == len(truth.vts)


def test_scatterers_are_those_of_the_city_and_change_nothing_else(recording: Recording) -> None:
    """Nothing in a world says that there are none; the other draws are those of the world without; another drive meets
    the same points."""
    assert "scatterers" not in small_world(scatterers=0.0).radio.model_dump()
    config, truth = small_world(scatterers=3.0), recording.truth
    one, other = simulate(config, 1, 0), simulate(config, 2, 5)
    assert truth is not None and one.truth is not None and other.truth is not None
    assert not recording.scatterers and truth.vts.scatterer is None
    np.testing.assert_array_equal(one.odometry, recording.odometry)
    np.testing.assert_array_equal(one.start_pose, recording.start_pose)
    np.testing.assert_array_equal(one.truth.clock_offsets_m, truth.clock_offsets_m)
    mirrors = one.truth.vts.position_m[~one.truth.vts.scatters]
    np.testing.assert_array_equal(mirrors, truth.vts.position_m)
    ours, theirs = (t.vts.position_m[t.vts.scatters] for t in (one.truth, other.truth))
    assert len(ours) > 5 and len(np.unique(np.concatenate([ours, theirs]), axis=0)) < 1.3 * max(len(ours), len(theirs))
    all_m = prepare(config, 1, 0).scatterers
    assert all_m is not None and (np.abs(ours[:, None] - all_m.position_m).sum(axis=2).min(axis=1) == 0.0).all()
    visible = one.truth.vts.visible[one.truth.vts.scatters[one.truth.vts.visible[:, 0]]]
    assert np.median(visible[:, 2] - visible[:, 1]) * 0.075 > 5.0  # s, at 0.9 m/s


def test_a_site_that_illuminates_is_a_vt_though_no_line_of_sight_leads_to_it() -> None:
    none = np.zeros((0, 3), np.int64)
    facets = np.array([[-1, -2], [-1, -1], [3, -1]])
    vts = VirtualTransmitters(np.eye(3), np.array([1, 0, 2]), np.array([1, 0, 1]), facets, none, np.array([1, 0, 0]))
    more = with_sites(vts, np.arange(9.0).reshape(3, 3))
    assert more.site.tolist() == [1, 0, 2, 1] and more.order.tolist() == [1, 0, 1, 0]
    assert more.position_m[3].tolist() == [3.0, 4.0, 5.0] and more.scatters.tolist() == [True, False, False, False]
    assert with_sites(replace(vts, scatterer=None), np.eye(3)).scatterer is None


def test_scatterers_are_saved_and_only_where_there_are_some(recording: Recording, tmp_path: Path) -> None:
    with_some = simulate(small_world(scatterers=2.0), 1, 0)
    for r, name in ((with_some, "some"), (recording, "none")):
        r.save(tmp_path / name)
        assert_identical(r, Recording.load(tmp_path / name))
        with h5py.File(tmp_path / name) as file:
            assert ("truth/vts/scatterer" in file) == (name == "some")


@pytest.mark.slow
def test_signal_front_end_gives_the_recording_pose_by_pose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    config = small_world(front_end="signal")
    short = {"distance_m": 2.0, "duration_s": 12.0, "stops": 0, "snapshot_interval_s": 0.9}
    config = config.model_copy(update={"vehicle": config.vehicle.model_copy(update=short)})
    r, world = simulate(config, 1, 0), prepare(config, 1, 0)
    streams, m, truth = world.streams(), r.measurements, r.truth
    assert truth is not None and len(m) > 4 * len(r.time_s)
    for t in (0, len(r.time_s) - 1, 7):
        found, paths = world.measure(
            world.drive.poses[t : t + 1], world.drive.velocity[t : t + 1], t, streams, r.odometry[t : t + 1]
        )
        rows = slice(r.rows[t], r.rows[t + 1])
        np.testing.assert_allclose(found.measurements.distance_m, m.distance_m[rows], rtol=0.0, atol=1e-6)
        real = found.path >= 0
        np.testing.assert_allclose(
            paths.vt_position_m[found.path[real]], truth.vts.position_m[truth.measurement_vt[rows][real]], atol=1e-6
        )


def test_truth_of_the_vts(recording: Recording) -> None:
    truth, links = recording.truth, recording.links
    assert truth is not None
    vts, m = truth.vts, recording.measurements
    real = truth.measurement_vt >= 0
    np.testing.assert_array_equal(vts.site[truth.measurement_vt[real]], links.site[m.link[real]])
    sight = vts.order == 0
    assert real.any()
    assert sight.any()
    np.testing.assert_allclose(vts.position_m[sight], truth.site_positions_m[vts.site[sight]])
    keys = np.column_stack([vts.site, vts.facets])
    assert len(np.unique(keys, axis=0)) == len(keys)
    first, last = vts.visible[:, 1], vts.visible[:, 2]
    for v, t in zip(truth.measurement_vt[real], m.snapshot[real], strict=True):
        own = vts.visible[:, 0] == v
        assert ((first[own] <= t) & (t <= last[own])).any()


def test_start_is_drawn_around_the_truth() -> None:
    world = small_world()
    vehicle = world.vehicle.model_copy(update={"start_std_m": 2.0, "start_std_deg": 3.0})
    prepared = prepare(world.model_copy(update={"vehicle": vehicle}), 1, 0)
    moved = prepared.start_pose - prepared.drive.poses[0]
    assert (np.abs(moved[[0, 1, 3]]) > 0.0).all()
    assert (moved[[2, 4, 5]] == 0.0).all()
    assert np.abs(moved[:2]).max() < 10.0
    np.testing.assert_array_equal(prepare(world, 1, 0).start_pose, prepared.drive.poses[0])


def test_a_city_per_trial() -> None:
    world = small_world()
    world = world.model_copy(update={"city": world.city.model_copy(update={"seed": "trial"})})
    one, two = prepare(world, 1, 0), prepare(world, 1, 1)
    assert one.scene.city.vertices.shape != two.scene.city.vertices.shape
    np.testing.assert_array_equal(one.scene.city.vertices, prepare(world, 1, 0).scene.city.vertices)


def test_visible_intervals_worked_example() -> None:
    vt, snapshot = np.array([1, 0, 1, 1, 0, 1]), np.array([3, 5, 4, 7, 6, 8])
    assert visible_intervals(vt, snapshot).tolist() == [[0, 5, 6], [1, 3, 4], [1, 7, 8]]
    assert visible_intervals(np.empty(0, np.int64), np.empty(0, np.int64)).shape == (0, 3)


def test_a_drive_without_any_measurement_and_with_known_offsets() -> None:
    r = simulate(small_world(detection_scale=0.0, clutter_scale=0.0, clock_offset_std_m=0.0), 1, 0)
    assert r.truth is not None and len(r.measurements) == 0 and len(r.truth.vts) > 0
    assert (r.truth.clock_offsets_m == 0.0).all() and (r.sites.clock_offset_std_m == 0.0).all()
