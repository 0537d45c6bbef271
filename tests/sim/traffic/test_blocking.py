"""Blocking by boxes against ray casts of trimesh, and a bus beside the car in a street of `canyon`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_triangle import ray_triangle_id

from cellslam.scenarios import load
from cellslam.sim.rays.paths import Paths
from cellslam.sim.traffic import Traffic, blocked_paths
from cellslam.sim.world import World, prepare

Array = np.ndarray


def boxes(count: int, rng: np.random.Generator, moments: int = 3, spread_m: float = 40.0) -> Traffic:
    """Boxes that stand or move by up to a few metres and half a turn between moments, on uneven ground."""
    size = rng.uniform([2.0, 1.0, 1.0], [14.0, 2.6, 4.0], (count, 3))
    start = rng.uniform([-spread_m, -spread_m, -0.5, -np.pi], [spread_m, spread_m, 0.5, np.pi], (count, 4))
    moved = np.cumsum(rng.uniform([-4, -4, 0, -1.5], [4, 4, 0, 1.5], (moments, count, 4)), axis=0)
    return Traffic(("bus",) * count, size, 0.5 * np.arange(moments), start + moved)


def lines(receivers: Array, transmitters: Array, points: list[list[Array]]) -> Paths:
    """Paths from transmitter i to receiver i by way of up to two points; all else is left empty."""
    count = len(receivers)
    way = np.full((count, 2, 3), np.nan)
    for row, own in enumerate(points):
        way[row, : len(own)] = np.reshape(own, (-1, 3))
    none, nothing = np.full((count, 2), -1), np.zeros(count)
    rows = np.arange(count)
    order = np.array([len(own) for own in points])
    return Paths(rows, rows, order, none, none[:, 0], way, receivers, *[nothing] * 5, np.zeros((count, 2, 2), complex))


def cast(traffic: Traffic, time_s: float, start: Array, end: Array) -> set[tuple[int, int]]:
    """Return (segment, vehicle) of all segments (n, 3) that meet a vehicle, by trimesh; no end may be in a box."""
    k, part = divmod(time_s / 0.5, 1.0)
    k = min(int(k), len(traffic.poses) - 2)
    poses = (1 - part) * traffic.poses[k] + part * traffic.poses[k + 1]
    meshes = []
    for (x, y, ground, yaw), size in zip(poses, traffic.size_m, strict=True):
        turn = trimesh.transformations.rotation_matrix(yaw, [0, 0, 1])
        turn[:3, 3] = x, y, ground + size[2] / 2
        meshes.append(trimesh.creation.box(size, turn))
    mesh = trimesh.util.concatenate(meshes)
    step = end - start
    triangle, ray, where = ray_triangle_id(mesh.triangles, start, step, mesh.face_normals, All(mesh))
    reach = np.linalg.norm(where - start[ray], axis=1) <= np.linalg.norm(step, axis=1)[ray]
    return set(zip(ray[reach].tolist(), (triangle[reach] // len(meshes[0].faces)).tolist(), strict=True))


class All:
    """In place of an R-tree: every triangle may be met."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.count, self.bounds = len(mesh.faces), mesh.bounds.ravel()

    def intersection(self, _: Array) -> range:
        return range(self.count)


def test_blocking_is_what_trimesh_casts() -> None:
    rng = np.random.default_rng(5)
    traffic = boxes(30, rng, spread_m=25.0)
    count = 1200
    low, high = [-30, -30, 0.1], [30, 30, 6.0]
    receivers = rng.uniform(low, high, (count, 3))
    transmitters = rng.uniform([-300, -300, 0.5], [300, 300, 45.0], (count, 3))
    points = [[rng.uniform(low, [30, 30, 12.0]) for _ in range(rng.integers(3))] for _ in range(count)]
    time_s = rng.choice([0.0, 0.2, 0.73], count)
    paths = lines(receivers, transmitters, points)
    found = blocked_paths(traffic, paths, transmitters, receivers, time_s)
    answers = set(zip(found.path.tolist(), found.vehicle.tolist(), strict=True))
    assert len(answers) == len(found.path)
    met = 0
    for moment in np.unique(time_s):
        # Paths with an end or a point in a box are left out: trimesh casts at surfaces only.
        way = {
            row: np.array([transmitters[row], *points[row], receivers[row]]) for row in np.flatnonzero(time_s == moment)
        }
        way = {row: corners for row, corners in way.items() if not inside(traffic, moment, corners).any()}
        owner = np.repeat(list(way), [len(corners) - 1 for corners in way.values()])
        start, end = (np.concatenate([corners[part] for corners in way.values()]) for part in (np.s_[:-1], np.s_[1:]))
        expected = {(int(owner[segment]), vehicle) for segment, vehicle in cast(traffic, moment, start, end)}
        assert {pair for pair in answers if pair[0] in way} == expected
        met += len(expected)
    assert met > 500
    assert np.array_equal(found.free(count), ~np.isin(np.arange(count), found.path))


def inside(traffic: Traffic, time_s: float, points: Array) -> Array:
    """Return which points (n, 3) are in any box."""
    poses = traffic.at(np.array([time_s]))[0]
    out = np.zeros(len(points), bool)
    for (x, y, ground, yaw), size in zip(poses, traffic.size_m, strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        local = (points - [x, y, ground]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        out |= (np.abs(local - [0, 0, size[2] / 2]) <= size / 2).all(axis=1)
    return out


def test_a_box_that_holds_the_receiver_blocks_nothing() -> None:
    traffic = Traffic(("bus", "bus"), np.tile([12.0, 2.5, 3.1], (2, 1)), np.arange(2.0), np.zeros((2, 2, 4)))
    traffic.poses[:, 1, 0] = 10.0
    receiver, transmitter = np.array([[0.0, 0.0, 1.8]]), np.array([[300.0, 0.0, 20.0]])
    found = blocked_paths(traffic, lines(receiver, transmitter, [[]]), transmitter, receiver, np.zeros(1))
    assert found.vehicle.tolist() == [1]


def test_who_comes_in_anew_is_nowhere_in_between() -> None:
    poses = np.zeros((2, 2, 4))
    poses[1, :, 0] = 3.0, 400.0
    traffic = Traffic(("car", "car"), np.ones((2, 3)), np.array([0.0, 0.5]), poses)
    assert traffic.at(np.array([0.0, 0.25, 0.5]))[:, :, 0].tolist() == [[0.0, 400.0], [1.5, 400.0], [3.0, 400.0]]
    np.testing.assert_allclose(
        traffic.outlines(np.array([0.5]))[0, 0], [[3.5, 0.5], [2.5, 0.5], [2.5, -0.5], [3.5, -0.5]]
    )


@pytest.fixture(scope="module")
def canyon() -> World:
    return prepare(load("canyon").world, 75000, 0)


def test_a_bus_beside_the_car_hides_the_sites_behind_it(canyon: World) -> None:
    poses = canyon.drive.poses
    paths, nothing = canyon.trace(poses, np.arange(len(poses)))
    assert len(nothing.path) == 0 and canyon.traffic is None
    length, width, height = 12.0, 2.55, 3.1
    seen = np.flatnonzero(paths.order == 0)[::200]
    hidden = []
    for row in seen:
        t, site = paths.receiver[row], canyon.sites_m[paths.transmitter[row]]
        away = np.hypot(*(site - poses[t, :3])[:2])
        climb = (site[2] - poses[t, 2]) / away
        towards = np.arctan2(*(site - poses[t, :3])[1::-1])
        for gap in (2.0, 3.0, 4.0, 6.0, 9.0):
            # Broadside to the line of sight: it meets the near side at `gap` and is over the roof, or not, there.
            centre = poses[t, :2] + (gap + width / 2) * np.array([np.cos(towards), np.sin(towards)])
            pose = np.tile([*centre, 0.0, towards + np.pi / 2], (2, 1, 1))
            bus = Traffic(("bus",), np.array([[length, width, height]]), np.array([0.0, 1000.0]), pose)
            free = replace(canyon, traffic=bus).free_paths(poses[t : t + 1], np.array([t]))
            lost = not ((free.order == 0) & (free.transmitter == paths.transmitter[row])).any()
            assert lost == (poses[t, 2] + climb * gap <= height), (t, gap)
            hidden.append(lost)
    assert 10 < sum(hidden) < len(hidden) - 10
