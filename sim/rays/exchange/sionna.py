"""Paths of Sionna RT 1.x and 2.x, as an .npz with the arrays of its `Paths` under their names.

Receivers R, transmitters T, paths P, depth D. With synthetic arrays (the solver's default) `tau`, `theta_t`, `phi_t`,
`theta_r`, `phi_r`, `valid` are (R, T, P), `interactions` (D, R, T, P), `vertices` (D, R, T, P, 3); without, an axis of
antennas follows each of R and T. `a` is (R, receiving antennas, T, sending antennas, P), complex or a pair of real and
imaginary part. theta is the zenith angle, phi the azimuth, in the scene's frame, of departure and of where a path comes
from; tau is absolute; `a` has no phase of the delay; padding is tau = -1 and zeros. Source: NVlabs/sionna-rt,
src/sionna/rt/path_solvers/paths.py, versions 1.0.1 and 2.2.0 (Apache-2.0).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.data_files import arrays_of
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.rays.exchange.traced_paths import EXACT, ByLink, Columns, Tolerance, Traced, traced, zenith
from cellslam.sim.rays.paths import Floats, Ints

NEEDED = ("a", "tau", "theta_r", "phi_r", "theta_t", "phi_t")
FLAT, DEEP = (*NEEDED[1:], "valid"), ("interactions", "vertices")
SPECULAR, DIFFRACTION, NO_OBJECT = 1, 8, 0xFFFFFFFF
POLARISATIONS = {"V": (1,), "H": (0,), "VH": (1, 0)}  # rows of (H, V) by antenna


def read_sionna(
    path: Path, polarisation: str = "V", transmitters_m: Floats | None = None, receivers_m: Floats | None = None,
    tolerance: Tolerance = EXACT,
) -> Traced:  # fmt: skip
    """Return the paths of an .npz; positions (S, 3) and (N, 3) in m are its `sources` and `targets` if not given.

    `polarisation` of the isotropic antenna at both ends: "V" (along theta), "H" (along phi), or "VH", a pair of both.
    Raises InputError naming the array that does not fit.
    """
    arrays = _loaded(path)
    tau = arrays["tau"]
    if tau.ndim not in (3, 5):
        raise InputError(
            f"{path}: tau has {tau.ndim} dimensions; those of Sionna RT 1.x and 2.x have 3, or 5 without synthetic "
            "arrays. Earlier versions have a batch axis and delays counted from the first path: save them again"
        )
    geometry = {name: _of_first_antennas(name, arrays[name], tau.ndim) for name in (*FLAT, *DEEP) if name in arrays}
    tau = geometry["tau"]
    for name in NEEDED[2:]:
        if geometry[name].shape != tau.shape:
            raise InputError(f"{path}: {name} has shape {arrays[name].shape}, tau {arrays['tau'].shape}")
    valid = geometry["valid"].astype(bool) if "valid" in geometry else tau >= 0.0
    valid = valid & (tau >= 0.0)
    receiver, transmitter, _ = np.nonzero(valid)
    gain = _gain(path, arrays["a"], polarisation, (tau.shape[0], tau.shape[1], tau.shape[2]))[valid]
    order, points = _interactions(path, geometry, valid)
    columns = Columns(
        receiver=receiver.astype(np.int64), transmitter=transmitter.astype(np.int64), order=order,
        delay_s=tau[valid],
        arrival_rad=np.column_stack([geometry["phi_r"][valid], zenith(geometry["theta_r"][valid])]),
        departure_rad=np.column_stack([geometry["phi_t"][valid], zenith(geometry["theta_t"][valid])]),
        gain=gain, points_m=points,
    )  # fmt: skip
    sent = _positions(path, arrays, "sources", tau.shape[1], transmitters_m)
    received = _positions(path, arrays, "targets", tau.shape[0], receivers_m)
    carrier = float(arrays["frequency"]) if "frequency" in arrays else None
    return traced(str(path), columns, sent, received, carrier, tolerance)


def _loaded(path: Path) -> dict[str, NDArray[Any]]:
    try:
        arrays = arrays_of(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not an .npz of arrays ({one_line(error)})") from error
    if "a" not in arrays and {"a_real", "a_imag"} <= set(arrays):
        arrays["a"] = arrays["a_real"] + 1j * arrays["a_imag"]
    missing = [name for name in NEEDED if name not in arrays]
    if missing:
        raise InputError(f"{path}: has no array '{missing[0]}' (it has: {', '.join(arrays)})")
    real = {name: array for name, array in arrays.items() if array.dtype.kind == "f"}
    return arrays | {name: array.astype(np.float64) for name, array in real.items()}


def _of_first_antennas(name: str, array: NDArray[Any], dimensions: int) -> NDArray[Any]:
    """Return an array of geometry without its axes of antennas, one after receivers and one after transmitters."""
    if dimensions == 3:
        return array
    receivers = 1 if name in DEEP else 0
    alone: NDArray[Any] = np.take(np.take(array, 0, axis=receivers + 1), 0, axis=receivers + 2)
    return alone


def _gain(path: Path, a: NDArray[Any], polarisation: str, shape: tuple[int, int, int]) -> NDArray[np.complex128]:
    """Return gains (R, T, P, 2, 2) in (H, V) of coefficients (R, antennas, T, antennas, P).

    Sionna's vertical antenna points along theta, downwards; V is the unit vector of growing elevation.
    """
    if a.ndim == 6 and a.shape[0] == 2 and a.dtype.kind == "f":
        a = a[0] + 1j * a[1]
    rows = POLARISATIONS[polarisation]
    receivers, transmitters, paths = shape
    expected = (receivers, len(rows), transmitters, len(rows), paths)
    if a.shape != expected:
        raise InputError(
            f"{path}: a has shape {a.shape}, with polarisation {polarisation} {expected} is expected: one isotropic "
            "antenna at both ends, or say another --polarisation"
        )
    out = np.zeros((*shape, 2, 2), np.complex128)
    for i, row in enumerate(rows):
        for j, column in enumerate(rows):
            out[..., row, column] = a[:, i, :, j] * (-1.0 if row != column else 1.0)
    return out


def _interactions(path: Path, geometry: dict[str, NDArray[Any]], valid: NDArray[np.bool_]) -> tuple[Ints, Floats]:
    """Return the number of interactions (P,) and their places (P, D, 3), NaN none."""
    if "interactions" not in geometry:
        raise InputError(f"{path}: has no array 'interactions', which tells lines of sight and padding apart")
    codes = np.moveaxis(geometry["interactions"], 0, -1)[valid]
    order = (codes != 0).sum(axis=1).astype(np.int64)
    depth = codes.shape[1]
    points = np.full((len(order), depth, 3), np.nan)
    if "vertices" in geometry:
        places = np.moveaxis(geometry["vertices"], 0, -2)[valid]
        points = np.where((np.arange(depth) < order[:, None])[..., None], places, np.nan)
    return order, np.asarray(points, np.float64)


def _positions(path: Path, arrays: dict[str, NDArray[Any]], name: str, count: int, given: Floats | None) -> Floats:
    """Return positions (count, 3) in m; Dr.Jit's points are (3, count), which says (3, 3) nothing."""
    places = arrays.get(name) if given is None else given
    if places is None:
        raise InputError(f"{path}: has no array '{name}': save it too, or give the positions (--bs, --rx)")
    if places.shape == (3, count) and count != 3:
        places = places.T
    if places.shape != (count, 3):
        raise InputError(f"{path}: {name} has shape {places.shape}, expected ({count}, 3)")
    return np.asarray(places, np.float64)


def write_sionna(path: Path, t: Traced, carrier_hz: float) -> None:
    """Write paths as an .npz, as of synthetic arrays with a pair of isotropic V and H antennas at both ends."""
    p, by_link = t.paths, ByLink(t.paths, len(t.receivers_m), len(t.transmitters_m))
    depth = int(p.order.max(initial=0))

    def filled(values: NDArray[Any], padding: float = 0.0) -> NDArray[Any]:
        return by_link.filled(values, padding)

    used = np.arange(depth) < p.order[:, None]
    code = np.where(p.edge >= 0, DIFFRACTION, SPECULAR)[:, None]
    objects = np.where(p.facets >= 0, p.facets, NO_OBJECT).astype(np.uint32)[:, :depth]
    signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
    both = (p.gain * signs)[:, ::-1, ::-1]  # (V, H) of theirs
    np.savez_compressed(
        path,
        a=np.moveaxis(filled(both), (0, 3, 1, 4, 2), range(5)),
        tau=filled(p.length_m / SPEED_OF_LIGHT_MPS, -1.0), valid=filled(np.ones(len(p), bool)),
        theta_r=filled(zenith(p.elevation_rad)), phi_r=filled(p.azimuth_rad),
        theta_t=filled(zenith(p.departure_elevation_rad)), phi_t=filled(p.departure_azimuth_rad),
        interactions=np.moveaxis(filled(np.where(used, code, 0).astype(np.uint32)), -1, 0),
        objects=np.moveaxis(filled(objects, NO_OBJECT), -1, 0),
        vertices=np.moveaxis(filled(np.nan_to_num(p.points_m[:, :depth])), -2, 0),
        sources=t.transmitters_m, targets=t.receivers_m, frequency=carrier_hz,
    )  # fmt: skip
