"""Ways that are drawn between buildings: in the middle, clear of walls, all connected."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from cellslam.sim.city.ways import CLEAR_M, largest_network, ways_between

FAR = (1000.0, 340_000.0)  # as in national coordinates


def test_ways_keep_to_the_middle_between_blocks() -> None:
    corners = [(x, y) for x in (0.0, 50.0, 100.0) for y in (0.0, 50.0)]
    plans = [shapely.box(x, y, x + 30.0, y + 30.0) for x, y in corners]
    plans.append(shapely.box(130.0, 0.0, 140.0, 30.0))  # touches its neighbour: one block
    moved = [shapely.transform(plan, lambda points: points + FAR) for plan in plans]
    ways = shapely.union_all([shapely.LineString(line) for line in ways_between(moved)])
    assert shapely.get_num_geometries(shapely.node(ways)) > 6
    assert shapely.distance(ways, shapely.union_all(moved)) > CLEAR_M
    for middle in ((40.0, 15.0), (90.0, 65.0), (15.0, 40.0), (115.0, 40.0)):
        assert shapely.distance(ways, shapely.Point(np.add(middle, FAR))) < 1.5
    assert shapely.distance(ways, shapely.Point(np.add((130.0, 15.0), FAR))) > 10.0
    assert shapely.get_num_geometries(shapely.unary_union(shapely.buffer(ways, 0.01))) == 1


def test_one_building_has_a_way_around_it() -> None:
    (way,) = ways_between([shapely.box(0.0, 0.0, 40.0, 20.0)])
    assert shapely.LineString(way).length == pytest.approx(2 * (73 + 53), rel=0.1)  # half way to the fence


def test_the_longest_part_is_kept() -> None:
    lines = [np.array(line, float) for line in ([(0, 0), (5, 0)], [(9, 9), (9, 30)], [(5, 0), (5, 9)])]
    assert [line.tolist() for line in largest_network(lines)] == [lines[1].tolist()]
    assert len(largest_network(lines[::2])) == 2 and largest_network([]) == []
