"""Other vehicles in the map, in the playback and in the report's scene, where there are any."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.trial import trial_map
from cellslam.benchmarks.report.playback import content
from cellslam.benchmarks.report.scene import scene_of
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.sim.traffic import traffic_of
from cellslam.sim.world import prepare

BUSY = {
    "vehicle.distance_m": 60.0, "vehicle.duration_s": 60.0, "vehicle.stops": 1, "traffic.vehicles_per_km": 60.0,
    "traffic.bus_share": 0.7, "traffic.lanes": 3, "traffic.oncoming_lanes": 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def busy() -> Recording:
    return simulate("lund-530", 75000, 0, BUSY)


def result(recording: Recording) -> TrialResult:
    assert recording.truth is not None
    poses = recording.truth.poses
    return TrialResult("toy", poses, np.tile(np.eye(6), (len(poses), 1, 1)))


def test_map_shows_vehicles_and_where_sites_are_behind_them(busy: Recording) -> None:
    figure = Figure(layout="constrained")
    assert trial_map.draw(figure, None, busy, {"toy": result(busy)})
    traffic = traffic_of(busy)
    assert traffic is not None
    for axes in figure.axes:
        (boxes,) = [one for one in axes.collections if isinstance(one, PolyCollection)]
        outlines = [path.vertices[:4] for path in boxes.get_paths()]
        np.testing.assert_allclose(outlines, traffic.outlines(busy.elapsed_s[[len(busy.time_s) // 2]])[0])
        (behind,) = [line for line in axes.lines if line.get_label() == "a site behind a vehicle"]
        assert len(behind.get_xdata()) > 3
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"vehicles, half-way", "a site behind a vehicle"} <= set(labels)


@pytest.mark.slow
def test_playback_moves_the_vehicles_also_where_the_world_is_not_known(busy: Recording) -> None:
    traffic = traffic_of(busy)
    assert traffic is not None
    for recording in (busy, dataclasses.replace(busy, provenance={})):
        (section,) = content(recording, result(recording))["trials"]
        vehicles, time_s = section["scene"]["vehicles"], np.array(section["time"])
        np.testing.assert_allclose(vehicles["size"], traffic.size_m)
        np.testing.assert_allclose(vehicles["poses"], traffic.at(time_s), atol=0.2)


def test_report_shows_vehicles_and_no_ray_through_them() -> None:
    world, steps = prepare(load("lund-530", BUSY).world, 75000, 0), np.arange(0, 800, 4)
    scene, _ = scene_of(world, steps)
    assert world.traffic is not None
    size, poses = np.array(scene["vehicles"]["size"]), np.array(scene["vehicles"]["poses"])
    np.testing.assert_allclose(size, world.traffic.size_m)
    np.testing.assert_allclose(poses, world.traffic.at(steps * 0.075), atol=0.006)
    paths, blocked = world.trace(world.drive.poses[steps], steps)
    assert len(blocked.path) > 3
    assert sum(len(rays) for rays in scene["rays"]) == blocked.free(len(paths)).sum()
