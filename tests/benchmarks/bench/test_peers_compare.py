"""The judge of `cellslam bench rays`: made-up answers of a peer are put in the classes that they belong to."""

from dataclasses import replace

import numpy as np
import pytest

from cellslam.benchmarks.bench.peers import PeerPaths
from cellslam.benchmarks.bench.peers_compare import compare
from cellslam.sim.city import ProceduralCityConfig, build_city
from cellslam.sim.rays import prepare, trace

SITE = np.array([10.3, -20.7, 31.0])
FIELDS = ("receiver", "order", "length_m", "azimuth_rad", "elevation_rad", "point_m", "gain")


@pytest.fixture(scope="module")
def met():
    config = ProceduralCityConfig(extent_m=240.0, block_size_m=80.0, open_share=0.6)
    scene = prepare(build_city(config, np.random.default_rng(5)))
    rng = np.random.default_rng(1)
    receivers = np.column_stack([rng.uniform(-100, 100, (200, 2)), np.full(200, 1.8)])
    receivers = receivers[scene.city.buildings_at(receivers) < 0]
    return scene, receivers, trace(scene, [SITE], receivers)


def answer(paths):
    columns = {name: getattr(paths, name).copy() for name in FIELDS if name != "point_m"}
    return PeerPaths(**columns, point_m=paths.points_m[:, 0].copy(), seconds=1.0)


def judged(met, ours, theirs):
    scene, receivers, _ = met
    return compare(scene, SITE, receivers, ours, theirs)


def test_the_same_paths_agree(met):
    found = judged(met, met[2], answer(met[2]))
    assert (found.agreeing, found.ours_only) == (len(met[2]), 0)
    assert (found.theirs_bent, found.theirs_copies, found.theirs_grazing, found.theirs_unexplained) == (0, 0, 0, 0)
    assert max(found.length_m, found.angle_rad, found.gain_db, found.field) < 1e-12


def test_copies_count_once_and_misses_are_told(met):
    theirs = answer(met[2])
    rows = np.r_[np.arange(len(theirs) - 3), 0, 1]
    theirs = replace(theirs, **{name: getattr(theirs, name)[rows] for name in FIELDS})
    found = judged(met, met[2], theirs)
    assert (found.agreeing, found.theirs_copies, found.ours_only) == (len(met[2]) - 3, 2, 3)


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({"length_m": 2e-3}, False),
        ({"elevation_rad": 2e-4}, False),
        ({"length_m": 5e-4}, True),
        ({"gain": 1.02}, False),
    ],
)
def test_what_is_further_off_than_allowed_is_not_explained(met, change, kept):
    theirs = answer(met[2])
    row = int(np.flatnonzero(theirs.order == 1)[0])
    for name, value in change.items():
        if name == "gain":
            theirs.gain[row] *= value
        else:
            getattr(theirs, name)[row] += value
    found = judged(met, met[2], theirs)
    assert found.theirs_unexplained == (0 if kept else 1)
    assert found.agreeing == len(theirs) - found.theirs_unexplained


def test_a_point_off_the_law_of_reflection_is_theirs(met):
    theirs, receivers = answer(met[2]), met[1]
    # Move a point along its wall: direction and length are then those of the bent path.
    row = int(np.flatnonzero(theirs.order == 1)[3])
    normal = met[0].city.facets.normal[met[2].facets[row, 0]]
    receiver = receivers[theirs.receiver[row]]
    reach = np.linalg.norm(theirs.point_m[row] - receiver)
    theirs.point_m[row] += 3e-4 * reach * np.cross(normal, [0.0, 0.0, 1.0])
    away = theirs.point_m[row] - receiver
    theirs.azimuth_rad[row] = np.arctan2(away[1], away[0])
    theirs.elevation_rad[row] = np.arctan2(away[2], np.hypot(away[0], away[1]))
    found = judged(met, met[2], theirs)
    assert (found.theirs_bent, found.theirs_unexplained) == (1, 0)
    assert 1e-4 < found.bent_rad < 4e-4


def test_paths_that_we_lack_are_not_explained(met):
    ours = met[2].take(met[2].order == 0)
    found = judged(met, ours, answer(met[2]))
    assert found.theirs_unexplained > 0.9 * (len(met[2]) - len(ours)) > 20
