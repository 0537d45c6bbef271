"""Paths beside those of Sionna RT, where it is installed and asked for."""

import os

import numpy as np
import pytest

from cellslam.benchmarks.bench.peers import ask_sionna, unavailable
from cellslam.benchmarks.bench.peers_compare import compare
from cellslam.sim.city import MeshCityConfig, build_city
from cellslam.sim.city.files.mitsuba import shipped_scene
from cellslam.sim.city.inside import OUTSIDE, enclosing
from cellslam.sim.rays import prepare, trace

WHY_NOT = unavailable("Sionna RT") if os.environ.get("CELLSLAM_PEERS") else "set CELLSLAM_PEERS=1 to compare"


@pytest.mark.skipif(WHY_NOT is not None, reason=str(WHY_NOT))
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["munich", "etoile"])
def test_what_sionna_finds_we_find(name):
    city = build_city(MeshCityConfig(path=f"sionna-rt:{name}", roughness_m=0.0), np.random.default_rng(0))
    low, high = city.bounds
    middle = (low + high) / 2
    rng = np.random.default_rng(1)
    places = np.column_stack([rng.uniform(-150, 150, (3000, 2)) + middle[:2], np.full(3000, low[2] + 1.8)])
    receivers = places[enclosing(city, places) == OUTSIDE][:600]
    site = np.array([middle[0] + 20.0, middle[1] + 10.0, low[2] + 60.0])
    assert len(receivers) == 600
    assert enclosing(city, site[None]).tolist() == [OUTSIDE]
    scene = prepare(city)
    ours = trace(scene, [site], receivers, ground_reflection=True)
    theirs = ask_sionna(shipped_scene(name), site, receivers, 1)
    found = compare(scene, site, receivers, ours, theirs)
    # Agreeing: within 1 mm, 1e-4 rad and 0.1 dB.
    assert found.agreeing > 500
    assert found.theirs_unexplained == 0
    assert found.theirs_grazing + found.theirs_bent <= 0.01 * found.agreeing
    assert found.gain_db is not None
    assert found.field is not None
    assert found.field < 2e-3
    # The judge is awake: without one facet, its paths are missed.
    reflecting = ours.facets[ours.order == 1, 0]
    lost = ours.take(ours.facets[:, 0] != np.bincount(reflecting).argmax())
    assert compare(scene, site, receivers, lost, theirs).theirs_unexplained > 0
