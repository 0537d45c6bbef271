"""Paths of other ray tracers, on a scene worked by hand in which every sign and zero of an angle tells."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation
from cellslam.sim.rays import Paths, trace
from cellslam.sim.rays.exchange import Tolerance, Traced, read_deepmimo, read_sionna, write_deepmimo, write_sionna

SENT = np.array([[120.0, -70.0, 35.0], [-60.0, 90.0, 22.0]])
RECEIVED = np.array([[-13.0, 42.0, 1.8], [31.0, -8.0, 2.1], [5.0, 77.0, 1.2]])
# Mirrors: a wall x = 150, a wall y = -110, the ground z = 0.
MIRRORS = ((0, 150.0), (1, -110.0), (2, 0.0))
Arrays = dict[str, np.ndarray]


def image(place: np.ndarray, axis: int, at: float) -> np.ndarray:
    out = place.copy()
    out[axis] = 2.0 * at - out[axis]
    return out


def by_hand() -> tuple[list[tuple[int, int, np.ndarray, list[np.ndarray]]], int]:
    """Return (receiver, transmitter, image, points) of lines of sight and single reflections, and paths a link."""
    rows = []
    for n, r in enumerate(RECEIVED):
        for s, t in enumerate(SENT):
            rows.append((n, s, t, []))
            for axis, at in MIRRORS:
                v = image(t, axis, at)
                rows.append((n, s, v, [r + (v - r) * (at - r[axis]) / (v[axis] - r[axis])]))
    return rows, 1 + len(MIRRORS)


def sionna(antennas: bool = False) -> Arrays:
    """Return the arrays of Sionna RT's paths, a place for one more than there are; as of one antenna at each end."""
    rows, count = by_hand()
    shape = (len(RECEIVED), len(SENT), count + 1)
    out: Arrays = {name: np.zeros(shape, np.float32) for name in ("theta_r", "phi_r", "theta_t", "phi_t")}
    out |= {"tau": np.full(shape, -1.0), "valid": np.zeros(shape, bool)}
    out["a"] = np.zeros((len(RECEIVED), 1, len(SENT), 1, count + 1), complex)
    out |= {"interactions": np.zeros((3, *shape), np.uint32), "vertices": np.zeros((3, *shape, 3), np.float32)}
    number = np.zeros(shape[:2], int)
    for n, s, v, points in rows:
        k = (n, s, number[n, s] + (number[n, s] >= 2))  # an empty place in the middle
        number[n, s] += 1
        corners = [SENT[s], *points, RECEIVED[n]]
        for end, way in (("r", corners[-2] - corners[-1]), ("t", corners[1] - corners[0])):
            unit = way / np.linalg.norm(way)
            out[f"theta_{end}"][k], out[f"phi_{end}"][k] = np.arccos(unit[2]), np.arctan2(unit[1], unit[0])
        out["tau"][k], out["valid"][k] = np.linalg.norm(v - RECEIVED[n]) / SPEED_OF_LIGHT_MPS, True
        out["a"][n, 0, s, 0, k[2]] = (0.3 + 0.1j) * 1e-4 * (1 + len(points))
        for place, point in enumerate(points):
            out["interactions"][(place, *k)], out["vertices"][(place, *k)] = 1, point
    if antennas:
        for name, array in out.items():
            if name != "a":
                first = 2 if name in ("interactions", "vertices") else 1
                out[name] = np.expand_dims(np.expand_dims(array, first), first + 2)
    return out | {"sources": SENT.T, "targets": RECEIVED}


def saved(folder: Path, arrays: Arrays) -> Path:
    np.savez(folder / "paths.npz", **arrays)
    return folder / "paths.npz"


def check(found: Traced) -> None:
    rows, _ = by_hand()
    p = found.paths
    assert len(p) == len(rows) and np.allclose(found.transmitters_m, SENT) and np.allclose(found.receivers_m, RECEIVED)
    for n, s, v, points in rows:
        near = np.linalg.norm(p.vt_position_m - v, axis=1) < 0.01
        (k,) = np.flatnonzero((p.receiver == n) & (p.transmitter == s) & near)
        assert p.order[k] == len(points)
        leaves = (points[0] if points else RECEIVED[n]) - SENT[s]
        angles = *azimuth_elevation(v - RECEIVED[n]), *azimuth_elevation(leaves)
        found_angles = p.azimuth_rad, p.elevation_rad, p.departure_azimuth_rad, p.departure_elevation_rad
        np.testing.assert_allclose([angle[k] for angle in found_angles], angles, atol=1e-5)
        assert np.allclose(p.gain[k, 1, 1], (0.3 + 0.1j) * 1e-4 * (1 + len(points)), rtol=1e-5)
    # A reflection seen from three places is one VT.
    assert len(np.unique(p.facets[p.order == 1, 0])) == len(SENT) * len(MIRRORS)


@pytest.mark.parametrize("antennas", [False, True])
def test_paths_of_sionna_rt(antennas: bool, tmp_path: Path) -> None:
    arrays = sionna(antennas)
    check(read_sionna(saved(tmp_path, arrays)))
    pair = {**arrays, "a": np.stack([arrays["a"].real, arrays["a"].imag])}
    check(read_sionna(saved(tmp_path, pair)))
    bare = {name: array for name, array in arrays.items() if name not in ("sources", "targets", "valid", "vertices")}
    check(read_sionna(saved(tmp_path, bare), "V", SENT, RECEIVED))
    with pytest.raises(InputError, match="no array 'sources': save it too, or give the positions"):
        read_sionna(saved(tmp_path, bare))


def changed(**changes: Callable[[Arrays], np.ndarray]) -> Arrays:
    arrays = sionna()
    return arrays | {name: change(arrays) for name, change in changes.items()}


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        (changed(theta_r=lambda a: np.pi / 2 - a["theta_r"]), "arrival .* would if their zenith angles are elev"),
        (changed(phi_r=lambda a: -a["phi_r"]), "arrival .* if their azimuths are clockwise"),
        (changed(phi_t=lambda a: np.pi / 2 - a["phi_t"]), "departure .* if their azimuths are counted from north"),
        (changed(phi_r=lambda a: a["phi_r"] + np.pi, theta_r=lambda a: np.pi - a["theta_r"]),
         "they point the other way"),
        (changed(phi_r=lambda a: np.degrees(a["phi_r"])), "angle of arrival"),
        (changed(tau=lambda a: np.where(a["valid"], 1e9 * a["tau"], -1.0)), "save absolute ones, in seconds"),
        (changed(vertices=lambda a: 0.0 * a["vertices"]), "its points make a path of"),
        (changed(tau=lambda a: a["tau"][None]), "tau has 4 dimensions.* Earlier versions"),
        (changed(a=lambda a: np.repeat(a["a"], 2, axis=1)), "say another --polarisation"),
    ],
)  # fmt: skip
def test_another_convention_does_not_pass(arrays: Arrays, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        read_sionna(saved(tmp_path, arrays))


def test_measured_paths_may_err(tmp_path: Path) -> None:
    rng, arrays = np.random.default_rng(1), sionna()
    del arrays["vertices"]
    arrays["tau"] = arrays["tau"] + arrays["valid"] * 2.0 / SPEED_OF_LIGHT_MPS * rng.uniform(-1, 1, arrays["tau"].shape)
    arrays["phi_r"] = arrays["phi_r"] + np.radians(4.0) * rng.uniform(-1, 1, arrays["tau"].shape)
    path = saved(tmp_path, arrays)
    for tolerance, says in ((Tolerance(), "are delays counted"), (Tolerance(2.1), "angle of arrival")):
        with pytest.raises(InputError, match=says):
            read_sionna(path, tolerance=tolerance)
    found = read_sionna(path, tolerance=Tolerance(2.1, np.radians(4.1))).paths
    np.testing.assert_allclose(np.sort(found.length_m), np.sort(SPEED_OF_LIGHT_MPS * arrays["tau"][arrays["valid"]]))


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "paths.npz", a=np.array([{}], object))
    with pytest.raises(InputError, match=r"not an \.npz of arrays"):
        read_sionna(tmp_path / "paths.npz")


def deepmimo(folder: Path, elevation: bool = False, away: bool = False) -> Path:
    """Write a scenario's matrices from the same scene, by the older names of some, as .npz, .npy and .mat."""
    arrays = sionna()
    for s, sent in enumerate(SENT):
        own = {name: array[:, s] for name, array in arrays.items() if array.ndim == 3}
        degrees = {name: np.degrees(own[name]) for name in ("phi_r", "theta_r", "phi_t", "theta_t")}
        if away:
            degrees |= {"phi_r": degrees["phi_r"] + 180.0, "theta_r": 180.0 - degrees["theta_r"]}
        if elevation:
            degrees |= {name: 90.0 - degrees[name] for name in ("theta_r", "theta_t")}
        a = arrays["a"][:, 0, s, 0]
        bounces = (arrays["interactions"][:, :, s] != 0).sum(axis=0)
        points = np.moveaxis(arrays["vertices"][:, :, s], 0, -2)
        known = np.arange(points.shape[-2]) < np.where(own["valid"], bounces, 0)[..., None]
        matrices = {
            "aoa_az": np.mod(degrees["phi_r"], 360.0), "aoa_el": degrees["theta_r"],
            "aod_az": degrees["phi_t"], "aod_el": degrees["theta_t"], "toa": own["tau"], "inter": bounces,
            "power": 20.0 * np.log10(np.maximum(np.abs(a), 1e-30)), "phase": np.degrees(np.angle(a)),
        }  # fmt: skip
        matrices = {key: np.where(own["valid"], matrix, np.nan).astype(np.float32) for key, matrix in matrices.items()}
        matrices |= {"inter_pos": np.where(known[..., None], points, np.nan), "rx_pos": RECEIVED, "tx_loc": sent[None]}
        for number, (key, matrix) in enumerate(matrices.items()):
            path = f"{folder / key}_t000_tx{s:03}_r001"
            if number % 3 == 0:
                np.savez(path, **{key: matrix})
            elif number % 3 == 1:
                np.save(path, matrix)
            else:
                savemat(f"{path}.mat", {key: matrix})
    (folder / "params.json").write_text(json.dumps({"rt_params": {"frequency": 3.5e9}}))
    return folder


@pytest.mark.parametrize("away", [False, True])
def test_matrices_of_deepmimo(away: bool, tmp_path: Path) -> None:
    found = read_deepmimo(deepmimo(tmp_path, away=away))
    check(found)
    assert found.carrier_hz == 3.5e9


def test_what_is_no_deepmimo_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no params\.json"):
        read_deepmimo(tmp_path)
    deepmimo(tmp_path, elevation=True)
    with pytest.raises(InputError, match="their zenith angles are elevations"):
        read_deepmimo(tmp_path)
    next(tmp_path.glob("phase_t000_tx000_r001.*")).unlink()
    with pytest.raises(InputError, match=r"no phase_t000_tx000_r001\.npz"):
        read_deepmimo(tmp_path)
    for path in tmp_path.glob("*_tx001_r001*"):
        path.rename(path.with_name(path.name.replace("tx001_r001", "tx000_r002")))
    with pytest.raises(InputError, match="has the receiver sets 1, 2: choose one with --rx-set"):
        read_deepmimo(tmp_path)


@pytest.fixture(scope="module")
def own(scenes: object) -> Traced:
    """Paths of our own tracer among two blocks: lines of sight, one and two reflections, diffraction."""
    city = scenes.city_of(scenes.box((20, -30, 0), (60, -10, 25)), scenes.box((-80, 20, 0), (-40, 70, 20)))  # type: ignore[attr-defined]
    receivers = np.column_stack([np.linspace(-30.0, 70.0, 41), np.linspace(-45.0, 12.0, 41), np.full(41, 1.8)])
    sites = np.array([[5.0, 40.0, 30.0], [-60.0, -35.0, 24.0]])
    return Traced(trace(city, sites, receivers, 2, diffraction=True), sites, receivers, 2.66e9)


def same(a: Paths, b: Paths, gain: Callable[[np.ndarray], np.ndarray], tolerance_m: float) -> None:
    def sequence(p: Paths) -> np.ndarray:
        return np.lexsort((np.round(p.length_m, 2), np.round(p.azimuth_rad, 3), p.order, p.transmitter, p.receiver))

    a, b = a.take(sequence(a)), b.take(sequence(b))
    assert np.array_equal(a.receiver, b.receiver) and np.array_equal(a.order, b.order)
    for name in ("vt_position_m", "length_m", "points_m"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=tolerance_m)
    for name in ("azimuth_rad", "elevation_rad", "departure_azimuth_rad", "departure_elevation_rad"):
        np.testing.assert_allclose(np.exp(1j * getattr(a, name)), np.exp(1j * getattr(b, name)), atol=1e-6)
    np.testing.assert_allclose(gain(a.gain), gain(b.gain), rtol=1e-4, atol=1e-10)


def test_our_own_paths_there_and_back(own: Traced, tmp_path: Path) -> None:
    p = own.paths
    assert {0, 1, 2} == set(p.order) and (p.edge >= 0).any()
    write_sionna(tmp_path / "p.npz", own, 2.66e9)
    found = read_sionna(tmp_path / "p.npz", "VH")
    same(p, found.paths, lambda g: g, 1e-6)
    assert found.carrier_hz == 2.66e9
    written = np.load(tmp_path / "p.npz")
    assert set(written["interactions"].ravel()) == {0, 1, 8}
    write_deepmimo(tmp_path / "p", own, 2.66e9)
    found = read_deepmimo(tmp_path / "p")
    same(p, found.paths, lambda g: g[:, 1, 1], 1e-3)
    assert found.carrier_hz == 2.66e9
    inter = np.load(tmp_path / "p/inter_t000_tx000_r001.npz")["inter"]
    assert set(inter[np.isfinite(inter)]) == {0, 1, 2, 11}
    # Reflections that the tracer knows by their facets are told apart by their images.
    static = (p.order > 0) & (p.edge < 0)
    ours = len(np.unique(np.column_stack([p.transmitter, p.facets])[static], axis=0))
    theirs = found.paths.facets[(found.paths.order > 0), 0]
    assert ours <= len(np.unique(theirs)) <= ours + np.count_nonzero(p.edge >= 0)
