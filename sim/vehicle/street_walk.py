"""Random walks on a city's street network: long enough, hardly a U-turn, few streets twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError

Floats = NDArray[np.float64]
Node = tuple[int, int]

GRID_M = 0.01
"""Street ends that fall into one cell of this size are one crossing."""
SHARP_RAD = np.radians(115.0)
"""A turn beyond this is taken only where the street ends."""


@dataclass(frozen=True)
class StreetNetwork:
    """Crossings and the streets between them: `edges[i]` is a centre line (n, 2), `ends[i]` its two nodes."""

    edges: tuple[Floats, ...]
    ends: tuple[tuple[Node, Node], ...]
    at: dict[Node, tuple[int, ...]]


def street_network(streets: Sequence[Floats]) -> StreetNetwork:
    """Return the network of centre lines (n, 2) in m, split where they cross; InputError if there are none."""
    import shapely

    if not streets:
        raise InputError(
            "this city has no street network: give the route as vehicle.waypoints_m = [[x, y], ...], "
            "or have 'cellslam init' draw one"
        )
    noded = shapely.unary_union([shapely.LineString(s) for s in streets], grid_size=GRID_M)
    lines = [g for g in getattr(noded, "geoms", [noded]) if g.length > 0.0]
    edges = tuple(np.asarray(line.coords, np.float64)[:, :2] for line in lines)
    ends = tuple((_node(e[0]), _node(e[-1])) for e in edges)
    at: dict[Node, list[int]] = {}
    for i, pair in enumerate(ends):
        for node in pair:
            at.setdefault(node, []).append(i)
    return StreetNetwork(edges, ends, {node: tuple(found) for node, found in at.items()})


def random_walk(network: StreetNetwork, length_m: float, rng: np.random.Generator) -> tuple[Floats, float]:
    """Return a polyline (n, 2) of at least `length_m`, and its cost in metres.

    The walk starts somewhere on a street, takes a street it has not used where there is one, and turns round
    only at a dead end. The cost is the distance driven twice, 1000 m per U-turn, and twice the mean distance from the
    middle of the network.
    """
    lengths = np.array([_length(e) for e in network.edges])
    edge = int(rng.choice(len(lengths), p=lengths / lengths.sum()))
    forward = bool(rng.integers(2))
    start_m = rng.uniform(0.0, 0.9) * lengths[edge]
    pieces, used = [_from(_directed(network, edge, forward), start_m)], {edge}
    total, cost = float(lengths[edge]) - start_m, 0.0
    while total < length_m:
        edge, forward, turn = _next(network, edge, forward, used, rng)
        cost += lengths[edge] if edge in used else 0.0
        cost += 1000.0 if turn > SHARP_RAD else 0.0
        used.add(edge)
        pieces.append(_directed(network, edge, forward))
        total += float(lengths[edge])
    walk = np.concatenate([pieces[0], *(p[1:] for p in pieces[1:])])
    return walk, cost + 2.0 * float(np.hypot(*(walk - _middle(network)).T).mean())


def _next(
    network: StreetNetwork, edge: int, forward: bool, used: set[int], rng: np.random.Generator
) -> tuple[int, bool, float]:
    """Return the next edge, its direction, and the turn into it."""
    node = network.ends[edge][1 if forward else 0]
    arriving = _directed(network, edge, forward)
    heading = arriving[-1] - arriving[-2]
    options = [
        (e, d) for e in sorted(set(network.at[node])) for d in (True, False) if network.ends[e][0 if d else 1] == node
    ]
    turns, weights = [], []
    for e, d in options:
        leaving = _directed(network, e, d)
        step = leaving[1] - leaving[0]
        turns.append(abs(float(np.arctan2(heading[0] * step[1] - heading[1] * step[0], heading @ step))))
        weights.append((1e-9 if turns[-1] > SHARP_RAD else 1.0) * (0.02 if e in used else 1.0))
    pick = int(rng.choice(len(options), p=np.array(weights) / sum(weights)))
    return *options[pick], turns[pick]


def _directed(network: StreetNetwork, edge: int, forward: bool) -> Floats:
    return network.edges[edge] if forward else network.edges[edge][::-1]


def _middle(network: StreetNetwork) -> Floats:
    corners = np.concatenate(network.edges)
    return np.asarray(0.5 * (corners.min(axis=0) + corners.max(axis=0)))


def _from(line: Floats, start_m: float) -> Floats:
    """Return the part of a line (n, 2) from `start_m` on."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    first = [np.interp(start_m, arc, line[:, 0]), np.interp(start_m, arc, line[:, 1])]
    return np.concatenate([[first], line[arc > start_m]])


def _node(point: Floats) -> Node:
    return round(point[0] / GRID_M), round(point[1] / GRID_M)


def _length(line: Floats) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())
