"""Blocking by boxes against points along the way, and a bus beside the car in a street of `canyon`."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

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


def inside(traffic: Traffic, time_s: float, points: Array, margin_m: float = 0.0) -> Array:
    """Return which points (n, 3) are in which boxes, each larger by `margin_m` on all sides: (n, vehicles)."""
    poses = traffic.at(np.array([time_s]))[0]
    c, s = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    off = points[:, None] - poses[:, :3] - np.stack([0 * c, 0 * c, traffic.size_m[:, 2] / 2], 1)
    own = np.stack([c * off[..., 0] + s * off[..., 1], c * off[..., 1] - s * off[..., 0], off[..., 2]], -1)
    return (np.abs(own) <= traffic.size_m / 2 + margin_m).all(axis=-1)


def test_blocked_is_what_passes_through_a_box() -> None:
    """Points every 5 cm along the way: those well in a box block, and where none is near a box nothing blocks."""
    rng, count = np.random.default_rng(5), 400
    traffic, low = boxes(30, rng, spread_m=25.0), [-30, -30, 0.1]
    receivers = rng.uniform(low, [30, 30, 6.0], (count, 3))
    transmitters = rng.uniform([-90, -90, 0.5], [90, 90, 45.0], (count, 3))
    points = [[rng.uniform(low, [30, 30, 12.0]) for _ in range(rng.integers(3))] for _ in range(count)]
    time_s = rng.choice([0.0, 0.2, 0.73], count)
    found = blocked_paths(traffic, lines(receivers, transmitters, points), transmitters, receivers, time_s)
    answers = np.zeros((count, len(traffic)), bool)
    answers[found.path, found.vehicle] = True
    assert answers.sum() == len(found.path)
    met = 0
    for row in range(count):
        corners = np.array([transmitters[row], *points[row], receivers[row]])
        if inside(traffic, time_s[row], corners).any():
            continue  # a box that holds an end is another matter
        parts = [np.linspace(a, b, int(np.linalg.norm(b - a) / 0.05) + 2) for a, b in pairwise(corners)]
        way = np.concatenate(parts)
        surely, maybe = (inside(traffic, time_s[row], way, margin).any(axis=0) for margin in (-0.03, 0.03))
        assert (answers[row] >= surely).all() and (answers[row] <= maybe).all()
        met += surely.sum()
    assert met > 150
    assert np.array_equal(found.free(count), ~answers.any(axis=1))


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
