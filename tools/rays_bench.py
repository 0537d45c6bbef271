"""Where `python -m tools rays` drives and transmits, and how it takes the time."""

from __future__ import annotations

import time
from dataclasses import dataclass

import networkx as nx
import numpy as np

from cellslam.benchmarks.trials.memory import peak_bytes
from cellslam.sim.city.city import GROUND, City
from cellslam.sim.city.inside import OUTSIDE, enclosing, surfaces
from cellslam.sim.errors import InputError
from cellslam.sim.rays import Scene, trace
from cellslam.sim.rays.paths import Floats

CELL_M = 6.0
HALF_EXTENT_M = 260.0
SPACING_M = 530.0 / 6850
FIRST_SITE_M = 265.0
RECEIVER_HEIGHT_M = 1.8
LONG_S = 10.0
STREET_SITE_M, MAST_M = 10.0, 35.0


@dataclass(frozen=True)
class Timing:
    """One size: the best time of several runs, what it found, and the peak memory of the process so far."""

    receivers: int
    transmitters: int
    paths: int
    seconds: float
    peak_bytes: int

    @property
    def paths_per_s(self) -> float:
        """Paths found per second."""
        return self.paths / self.seconds


def time_trace(
    scene: Scene, transmitters: Floats, receivers: Floats, max_order: int, repeat: int, ground_reflection: bool = False
) -> Timing:
    """Trace from transmitters (S, 3) to receivers (N, 3), in m, `repeat` times, or as often as ten seconds allow; keep
    the best time."""
    best, found, begin = np.inf, 0, time.perf_counter()
    for run in range(repeat):
        if run and time.perf_counter() - begin > LONG_S:
            break
        start = time.perf_counter()
        found = len(trace(scene, transmitters, receivers, max_order, ground_reflection=ground_reflection))
        best = min(best, time.perf_counter() - start)
    return Timing(len(receivers), len(transmitters), found, best, peak_bytes())


def drive_in(city: City) -> Floats:
    """Return the corners (n, 2) of a long way through the streets round the middle of the city.

    The way joins two free places far apart on a grid of six metres. Raises InputError where nothing is free.
    """
    low, high = city.bounds
    middle = (low + high)[:2] / 2
    half = min(HALF_EXTENT_M, float((high - low)[:2].max()) / 2)
    steps = np.arange(-half, half + CELL_M, CELL_M)
    cells = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    places = (cells + middle).reshape(-1, 2)
    free = enclosing(city, np.column_stack([places, ground_height(city, places) + RECEIVER_HEIGHT_M])) == OUTSIDE
    graph = nx.grid_2d_graph(len(steps), len(steps))
    graph.remove_nodes_from([(i, j) for i, j in graph if not free[i * len(steps) + j]])
    if len(graph) < 2:
        raise InputError(f"city '{city.name}' has no free place near its middle to drive through")
    component = graph.subgraph(max(nx.connected_components(graph), key=len))
    end = start = min(component)
    for _ in range(2):
        start, reached = end, nx.single_source_shortest_path_length(component, end)
        end = max(reached, key=lambda node: (reached[node], node))
    way = nx.shortest_path(component, start, end)
    return np.array([cells[i, j] + middle for i, j in way])


def ground_height(city: City, places_m: Floats) -> Floats:
    """Return the height (N,) of the ground in m at places (N, 2), the lowest vertex where there is none."""
    place, building, height = surfaces(city, np.column_stack([places_m, np.zeros(len(places_m))]))
    found, ground = np.full(len(places_m), -np.inf), building == GROUND
    np.maximum.at(found, place[ground], height[ground])
    return np.where(np.isfinite(found), found, city.bounds[0, 2])


def receivers_along(city: City, way: Floats, count: int) -> Floats:
    """Return `count` receivers (count, 3), eight centimetres apart along the way, there and back as often as needed.

    Less than 530 m of them are centred on the middle of the first 530 m, where the first site stands.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    start = max(0.0, min(FIRST_SITE_M, arc[-1] / 2) - 0.5 * count * SPACING_M)
    at = (start + np.arange(count) * SPACING_M) % (2.0 * arc[-1])
    at = np.where(at > arc[-1], 2.0 * arc[-1] - at, at)
    places = np.column_stack([np.interp(at, arc, way[:, 0]), np.interp(at, arc, way[:, 1])])
    return np.column_stack([places, ground_height(city, places) + RECEIVER_HEIGHT_M])


def sites_along(city: City, way: Floats, count: int) -> Floats:
    """Return transmitters (count, 3): every other one between the houses, the others on masts; the first in the
    middle of the first 530 m of the way.
    """
    first = min(int(FIRST_SITE_M / CELL_M), len(way) // 2)
    rows = (first + np.linspace(0, len(way), count, endpoint=False).astype(int)) % len(way)
    above = np.where(np.arange(count) % 2 == 0, STREET_SITE_M, MAST_M)
    flat = way[rows] + [0.37, 0.53]
    places = np.column_stack([flat, ground_height(city, flat) + above])
    return np.asarray(places[enclosing(city, places) == OUTSIDE], np.float64)
