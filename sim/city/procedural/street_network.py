"""A connected street network without dead ends: a jittered grid with some pieces left out, slightly bent."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np

from cellslam.sim.city.city import Floats
from cellslam.sim.city.city_config import ProceduralCityConfig

Node = tuple[int, int]
Edge = tuple[Node, Node]
BEND_POINTS = 5


def street_network(config: ProceduralCityConfig, rng: np.random.Generator) -> tuple[Floats, ...]:
    """Return street centre lines, each (n, 2) in metres, round the origin; ends that meet are bit-equal."""
    count = max(2, round(config.extent_m / config.block_size_m))
    positions = _nodes(count, config, rng)
    edges = [((i, j), (i + 1, j)) for i in range(count) for j in range(count + 1)]
    edges = sorted(edges + [((i, j), (i, j + 1)) for i in range(count + 1) for j in range(count)])
    left_out = _left_out(edges, count, config, rng)
    inner = 0.06 * config.irregularity / 0.25
    return tuple(
        _bent(positions[a], positions[b], inner * rng.uniform(-1.0, 1.0) if _is_inner(a, b, count) else 0.0)
        for a, b in edges
        if (a, b) not in left_out
    )


def _nodes(count: int, config: ProceduralCityConfig, rng: np.random.Generator) -> Floats:
    """Return node positions (count + 1, count + 1, 2): uneven rows and columns, each corner displaced."""
    steps = rng.uniform(1.0 - config.irregularity, 1.0 + config.irregularity, (2, count))
    lines = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
    lines = (lines / lines[:, -1:] - 0.5) * config.extent_m
    grid = np.stack(np.meshgrid(lines[0], lines[1], indexing="ij"), axis=-1)
    spacing = config.extent_m / count
    jitter = rng.uniform(-0.6, 0.6, grid.shape) * config.irregularity * spacing
    jitter[0, :, 0] = jitter[-1, :, 0] = jitter[:, 0, 1] = jitter[:, -1, 1] = 0.0
    jitter[[0, 0, -1, -1], [0, -1, 0, -1]] = 0.0
    return np.asarray(grid + jitter, np.float64)


def _is_inner(a: Node, b: Node, count: int) -> bool:
    return not any(a[axis] == b[axis] and a[axis] in (0, count) for axis in (0, 1))


def _left_out(edges: list[Edge], count: int, config: ProceduralCityConfig, rng: np.random.Generator) -> set[Edge]:
    """Choose inner edges to leave out; every corner keeps at least two streets."""
    inner = [edge for edge in edges if _is_inner(*edge, count)]
    wanted = round(config.merged_share * len(inner))
    degree = Counter(itertools.chain.from_iterable(edges))
    touched: set[Node] = set()
    dropped: set[Edge] = set()
    for index in rng.permutation(len(inner)):
        a, b = inner[index]
        if len(dropped) == wanted:
            break
        # One dropped edge per corner keeps the network connected: corners keep three streets at least.
        if {a, b} & touched or min(degree[a], degree[b]) < 3:
            continue
        touched |= {a, b}
        dropped.add((a, b))
    return dropped


def _bent(start: Floats, end: Floats, bend: float) -> Floats:
    """Return a line of five points that leaves the straight one by `bend` times its length."""
    s = np.linspace(0.0, 1.0, BEND_POINTS)[:, None]
    along = end - start
    line = start + s * along + 4.0 * s * (1.0 - s) * bend * np.array([-along[1], along[0]])
    line[0], line[-1] = start, end
    return np.asarray(line, np.float64)
