"""Random walks on a city's street network: long enough, hardly a U-turn, few streets twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

Node = tuple[int, int]

GRID_M = 0.01  # street ends that fall into one cell of this size are one crossing
SHARP_RAD = np.radians(115.0)  # a turn beyond this is taken only where the street ends


@dataclass(frozen=True)
class StreetNetwork:
    """The streets between crossings, each in both directions: `ways[i]` is a centre line (n, 2) from the crossing
    `begins[i]` to `ends[i]`; `ways[i ^ 1]` is the same street the other way.
    """

    ways: tuple[Floats, ...]
    begins: tuple[Node, ...]
    ends: tuple[Node, ...]


def street_network(streets: Sequence[Floats]) -> StreetNetwork:
    """Return the network of centre lines (n, 2) in m, split where they cross; InputError if there are none."""
    import shapely

    if not streets:
        raise InputError(
            "this city has no street network: give the route as vehicle.waypoints_m = [[x, y], ...], "
            "or have 'cellslam init' draw one"
        )
    noded = shapely.unary_union([shapely.LineString(s) for s in streets], grid_size=GRID_M)
    lines = [np.asarray(g.coords, np.float64)[:, :2] for g in getattr(noded, "geoms", [noded]) if g.length > 0.0]
    ways = tuple(way for line in lines for way in (line, line[::-1]))
    begins, ends = (tuple((round(w[k][0] / GRID_M), round(w[k][1] / GRID_M)) for w in ways) for k in (0, -1))
    return StreetNetwork(ways, begins, ends)


def random_walk(network: StreetNetwork, length_m: float, rng: np.random.Generator) -> tuple[Floats, float]:
    """Return a polyline (n, 2) of at least `length_m`, and its cost in metres.

    The walk starts somewhere on a street, takes a street it has not used where there is one, and turns round
    only at a dead end. The cost is the distance driven twice, 1000 m per U-turn, and twice the mean distance from the
    middle of the network.
    """
    edges = np.array([float(np.hypot(*np.diff(way, axis=0).T).sum()) for way in network.ways[::2]])
    edge = int(rng.choice(len(edges), p=edges / edges.sum()))
    way = 2 * edge + 1 - int(rng.integers(2))
    line, start_m = network.ways[way], rng.uniform(0.0, 0.9) * edges[edge]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    first = [np.interp(start_m, arc, line[:, 0]), np.interp(start_m, arc, line[:, 1])]
    pieces, used = [np.concatenate([[first], line[arc > start_m]])], {edge}
    total, cost = float(edges[edge]) - start_m, 0.0
    while total < length_m:
        way, turn = _next(network, way, used, rng)
        cost += edges[way // 2] if way // 2 in used else 0.0
        cost += 1000.0 if turn > SHARP_RAD else 0.0
        used.add(way // 2)
        pieces.append(network.ways[way])
        total += float(edges[way // 2])
    walk = np.concatenate([pieces[0], *(p[1:] for p in pieces[1:])])
    corners = np.concatenate(network.ways)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return walk, cost + 2.0 * float(np.hypot(*(walk - middle).T).mean())


def _next(network: StreetNetwork, way: int, used: set[int], rng: np.random.Generator) -> tuple[int, float]:
    """Return the next way, and the turn into it."""
    heading = network.ways[way][-1] - network.ways[way][-2]
    options = [other for other, begin in enumerate(network.begins) if begin == network.ends[way]]
    turns, weights = [], []
    for other in options:
        step = network.ways[other][1] - network.ways[other][0]
        turns.append(abs(float(np.arctan2(heading[0] * step[1] - heading[1] * step[0], heading @ step))))
        weights.append((1e-9 if turns[-1] > SHARP_RAD else 1.0) * (0.02 if other // 2 in used else 1.0))
    pick = int(rng.choice(len(options), p=np.array(weights) / sum(weights)))
    return options[pick], turns[pick]
