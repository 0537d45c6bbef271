"""Blocking by boxes against points along the way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cellslam.sim.rays.paths import Paths
from cellslam.sim.traffic import Traffic, blocked_paths

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


def outside_m(traffic: Traffic, time_s: float, points: Array) -> Array:
    """Return how far outside (n, vehicles) of boxes points (n, 3) are along the worst axis, negative within."""
    poses = traffic.at(np.array([time_s]))[0]
    c, s = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    off = points[:, None] - poses[:, :3]
    own = np.stack([c * off[..., 0] + s * off[..., 1], c * off[..., 1] - s * off[..., 0], off[..., 2]], -1)
    own[..., 2] -= traffic.size_m[:, 2] / 2  # boxes stand on the ground
    return (np.abs(own) - traffic.size_m / 2).max(axis=-1)


def test_blocked_is_what_passes_through_a_box() -> None:
    """Points every 10 cm along the way: those well in a box block, and where none is near a box nothing blocks."""
    rng, count = np.random.default_rng(5), 200
    traffic, low = boxes(30, rng, spread_m=25.0), [-30, -30, 0.1]
    receivers = rng.uniform(low, [30, 30, 6.0], (count, 3))
    transmitters = rng.uniform([-90, -90, 0.5], [90, 90, 15.0], (count, 3))
    points = [[rng.uniform(low, [30, 30, 12.0]) for _ in range(rng.integers(3))] for _ in range(count)]
    time_s = rng.choice([0.0, 0.2, 0.73], count)
    found = blocked_paths(traffic, lines(receivers, transmitters, points), transmitters, receivers, time_s)
    answers = np.zeros((count, len(traffic)), bool)
    answers[found.path, found.vehicle] = True
    assert answers.sum() == len(found.path)
    met = 0
    for row in range(count):
        corners = np.array([transmitters[row], *points[row], receivers[row]])
        if (outside_m(traffic, time_s[row], corners) <= 0.0).any():
            continue  # a box that holds an end is another matter
        way = [np.linspace(a, b, int(np.linalg.norm(b - a) / 0.1) + 2) for a, b in pairwise(corners)]
        nearest = outside_m(traffic, time_s[row], np.concatenate(way)).min(axis=0)
        assert answers[row][nearest < -0.06].all() and not answers[row][nearest > 0.06].any()
        met += (nearest < -0.06).sum()
    assert met > 40
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
