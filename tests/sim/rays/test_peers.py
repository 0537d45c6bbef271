"""Paths as Sionna RT saves them beside ours, where it is installed and asked for; `tools rays` compares speeds too."""

import os

import numpy as np
import pytest

from cellslam.sim.city import MeshCityConfig, build_city
from cellslam.sim.city.files.mitsuba import shipped_scene
from cellslam.sim.city.inside import OUTSIDE, enclosing
from cellslam.sim.rays import trace
from cellslam.sim.rays.exchange import read_sionna
from tools.peers import unavailable

WHY_NOT = unavailable("Sionna RT") if os.environ.get("CELLSLAM_PEERS") else "set CELLSLAM_PEERS=1 to compare"


@pytest.mark.skipif(WHY_NOT is not None, reason=str(WHY_NOT))
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("synthetic", [False, True])
def test_what_sionna_saves_is_read(synthetic, tmp_path):
    import sionna.rt as rt

    city = build_city(MeshCityConfig(path="sionna-rt:munich", roughness_m=0.0), np.random.default_rng(0))
    low, high = city.bounds
    middle = [*((low + high) / 2)[:2], low[2]]
    sites = middle + np.array([[20.0, 10.0, 60.0], [-80.0, 50.0, 70.0]])
    places = middle + np.column_stack([np.linspace(-150, 150, 100), np.linspace(-100, 60, 100), np.full(100, 1.8)])
    places = places[enclosing(city, places) == OUTSIDE][:30]
    scene = rt.load_scene(str(shipped_scene("munich")))
    scene.frequency = 2.66e9
    scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="VH")
    for kind, positions in ((rt.Transmitter, sites), (rt.Receiver, places)):
        for index, place in enumerate(positions):
            scene.add(kind(f"{kind.__name__} {index}", position=place.tolist()))
    # As its users call it: three interactions, refraction included.
    paths = rt.PathSolver()(scene, synthetic_array=synthetic, samples_per_src=100_000)
    names = ("tau", "theta_r", "phi_r", "theta_t", "phi_t", "interactions", "vertices", "valid")
    arrays = {name: getattr(paths, name).numpy() for name in names}
    ends = {"sources": paths.sources.numpy().T, "targets": paths.targets.numpy().T}
    np.savez(tmp_path / "paths.npz", a=paths.a[0].numpy() + 1j * paths.a[1].numpy(), **arrays, **ends)
    theirs = read_sionna(tmp_path / "paths.npz", "VH").paths
    ours = trace(city, sites, places, ground_reflection=True)
    assert set(ours.order) == {0, 1}
    assert len(theirs) > len(ours)
    for i in range(len(ours)):
        near = np.linalg.norm(theirs.vt_position_m - ours.vt_position_m[i], axis=1) < 0.02
        same = (theirs.receiver == ours.receiver[i]) & (theirs.transmitter == ours.transmitter[i])
        (j,) = np.flatnonzero(near & same & (theirs.order == ours.order[i]))
        assert np.abs(theirs.gain[j] - ours.gain[i]).max() < 1e-3 * np.abs(ours.gain[i]).max()
        turned = np.angle(np.exp(1j * (theirs.departure_azimuth_rad[j] - ours.departure_azimuth_rad[i])))
        assert abs(turned) < 1e-5
        assert abs(theirs.departure_elevation_rad[j] - ours.departure_elevation_rad[i]) < 1e-5
