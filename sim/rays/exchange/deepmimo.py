"""Paths of DeepMIMO version 4: a scenario's folder with `params.json` and a file for each matrix and link.

Files `KEY_t000_tx000_r001.npz` (also .npy, .mat) hold the matrix KEY of N receivers and P paths, NaN where there is
none: `rx_pos` (N, 3), `tx_pos` (1, 3) in m; `aoa_az`, `aod_az` in degrees, counter-clockwise from x; `aoa_el`, `aod_el`
in degrees, zenith angles; `delay` in s, absolute; `power` in dB of unit power sent, `phase` in degrees; `inter`, digits
from the transmitter on (0 line of sight, 1 reflection, 2 diffraction, 3 scattering, 4 transmission); `inter_pos`
(N, P, I, 3) in m. Angles of arrival point from the receiver to where the path comes from; some converted scenarios have
them the other way, which a line of sight or the last point shows. Source: DeepMIMO/DeepMIMO 4.0.1, deepmimo/consts.py,
its pages conventions and specs.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.data_files import arrays_of
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, unit_vector
from cellslam.sim.rays.exchange.traced_paths import EXACT, ByLink, Columns, Tolerance, Traced, traced, zenith
from cellslam.sim.rays.paths import Floats

NAME = "{key}_t{tx_set:03}_tx{tx:03}_r{rx_set:03}"
ALIASES = {"rx_loc": "rx_pos", "tx_loc": "tx_pos", "toa": "delay", "inter_loc": "inter_pos"}
NEEDED = ("rx_pos", "tx_pos", "aoa_az", "aoa_el", "aod_az", "aod_el", "delay", "power", "phase", "inter")
FILE = re.compile(r"(\w+)_t(\d+)_tx(\d+)_r(\d+)\.(npz|npy|mat)")
RECEIVERS, TRANSMITTERS = 1, 0  # sets that are written


def read_deepmimo(folder: Path, rx_set: int | None = None, tolerance: Tolerance = EXACT) -> Traced:
    """Return the paths of a scenario's folder, each of its transmitters one, to the receivers of a set.

    Coefficients are taken for vertical antennas. Raises InputError naming the file that does not fit.
    """
    if not (folder / "params.json").is_file():
        raise InputError(f"{folder}: no params.json: give the folder of a scenario, of one scene if it has several")
    links = _links(folder)
    sets = sorted({link[2] for link in links})
    if rx_set is None and len(sets) > 1:
        raise InputError(f"{folder}: has the receiver sets {', '.join(map(str, sets))}: choose one with --rx-set")
    chosen = sets[0] if rx_set is None else rx_set
    mine = [link for link in sorted(links) if link[2] == chosen]
    if not mine:
        raise InputError(f"{folder}: has no receiver set {chosen} (known: {', '.join(map(str, sets))})")
    sent, received, pieces = [], None, []
    for number, link in enumerate(mine):
        matrices = _matrices(folder, link, links[link])
        sent.append(matrices["tx_pos"].reshape(-1, 3)[0])
        if received is not None and not np.array_equal(received, matrices["rx_pos"]):
            raise InputError(f"{folder}: rx_pos differs between transmitters: choose their sets apart")
        received = matrices["rx_pos"]
        pieces.append(_columns(folder, matrices, number))
    assert received is not None
    depth = max(piece.points_m.shape[1] for piece in pieces)
    deep = [((0, 0), (0, depth - piece.points_m.shape[1]), (0, 0)) for piece in pieces]
    points = [np.pad(piece.points_m, room, constant_values=np.nan) for piece, room in zip(pieces, deep, strict=True)]
    pieces = [replace(piece, points_m=padded) for piece, padded in zip(pieces, points, strict=True)]
    columns = Columns(*(np.concatenate([getattr(piece, f.name) for piece in pieces]) for f in fields(Columns)))
    columns = _pointing_back(columns, np.array(sent), received)
    carrier_hz = None
    with suppress(ValueError, KeyError, TypeError):
        carrier_hz = float(json.loads((folder / "params.json").read_text("utf-8"))["rt_params"]["frequency"])
    return traced(str(folder), columns, np.array(sent), received, carrier_hz, tolerance)


def _links(folder: Path) -> dict[tuple[int, int, int], dict[str, Path]]:
    """Return the matrices' files by (transmitter set, transmitter, receiver set)."""
    out: dict[tuple[int, int, int], dict[str, Path]] = {}
    for path in sorted(folder.iterdir()):
        found = FILE.fullmatch(path.name)
        if found:
            link = (int(found[2]), int(found[3]), int(found[4]))
            out.setdefault(link, {})[ALIASES.get(found[1], found[1])] = path
    if not out:
        raise InputError(f"{folder}: holds no matrix, as {NAME.format(key='delay', tx_set=0, tx=0, rx_set=1)}.npz")
    return out


def _matrices(folder: Path, link: tuple[int, int, int], files: dict[str, Path]) -> dict[str, Floats]:
    missing = [key for key in NEEDED if key not in files]
    if missing:
        name = NAME.format(key=missing[0], tx_set=link[0], tx=link[1], rx_set=link[2])
        raise InputError(f"{folder}: no {name}.npz, .npy or .mat")
    return {key: _matrix(path, key) for key, path in files.items() if key in (*NEEDED, "inter_pos")}


def _matrix(path: Path, key: str) -> Floats:
    try:
        if path.suffix == ".mat":
            from scipy.io import loadmat

            held: Any = {k: v for k, v in loadmat(str(path)).items() if not k.startswith("__")}
        else:
            held = arrays_of(path)
        if path.suffix == ".npy":
            return np.asarray(held[""], np.float64)
        names = [name for name in held if ALIASES.get(name, name) == key]
        return np.asarray(held[names[0]], np.float64)
    except (OSError, ValueError, IndexError, KeyError) as error:
        raise InputError(f"{path}: holds no matrix '{key}' ({one_line(error)})") from error


def _columns(folder: Path, m: dict[str, Floats], transmitter: int) -> Columns:
    delay = m["delay"]
    for key in NEEDED[2:]:
        if m[key].shape != delay.shape:
            raise InputError(f"{folder}: {key} has shape {m[key].shape}, delay {delay.shape}")
    there = np.isfinite(delay) & np.isfinite(m["inter"])
    receiver = np.nonzero(there)[0].astype(np.int64)
    codes = m["inter"][there].astype(np.int64)
    order = np.where(codes > 0, np.floor(np.log10(np.maximum(codes, 1))) + 1, 0).astype(np.int64)
    gain = np.zeros((len(receiver), 2, 2), np.complex128)
    gain[:, 1, 1] = 10.0 ** (m["power"][there] / 20.0) * np.exp(1j * np.radians(m["phase"][there]))
    points = m["inter_pos"][there] if "inter_pos" in m else np.full((len(receiver), 1, 3), np.nan)
    return Columns(
        receiver=receiver, transmitter=np.full(len(receiver), transmitter, np.int64), order=order, delay_s=delay[there],
        arrival_rad=_angles(m, "aoa", there), departure_rad=_angles(m, "aod", there), gain=gain, points_m=points,
    )  # fmt: skip


def _angles(m: dict[str, Floats], end: str, there: NDArray[np.bool_]) -> Floats:
    return np.column_stack([np.radians(m[f"{end}_az"][there]), zenith(np.radians(m[f"{end}_el"][there]))])


def _pointing_back(c: Columns, sent: Floats, received: Floats) -> Columns:
    """Return the columns with angles of arrival that point to where the path comes from, as lines of sight tell."""
    sight = c.order == 0
    towards = sent[c.transmitter[sight]] - received[c.receiver[sight]]
    along = np.einsum("pi,pi->p", unit_vector(*c.arrival_rad[sight].T), towards)
    if not sight.any() or along.max() >= 0.0:
        return c
    return replace(c, arrival_rad=c.arrival_rad * [1.0, -1.0] + [np.pi, 0.0])


def write_deepmimo(folder: Path, t: Traced, carrier_hz: float) -> None:
    """Write a scenario's folder: transmitters are one set, receivers another; gains from vertical to vertical."""
    folder.mkdir(parents=True)
    for site, position in enumerate(t.transmitters_m):
        p = t.paths.take(t.paths.transmitter == site)
        by_link = ByLink(replace(p, transmitter=np.zeros_like(p.transmitter)), len(t.receivers_m), 1)

        def filled(values: NDArray[Any], by_link: ByLink = by_link) -> NDArray[np.float32]:
            return by_link.filled(values.astype(np.float32), np.nan)[:, 0]

        gain = p.gain[:, 1, 1]
        matrices = {
            "rx_pos": t.receivers_m.astype(np.float32), "tx_pos": position[None].astype(np.float32),
            "aoa_az": filled(np.degrees(p.azimuth_rad)), "aoa_el": filled(np.degrees(zenith(p.elevation_rad))),
            "aod_az": filled(np.degrees(p.departure_azimuth_rad)),
            "aod_el": filled(np.degrees(zenith(p.departure_elevation_rad))),
            "delay": filled(p.length_m / SPEED_OF_LIGHT_MPS),
            "power": filled(20.0 * np.log10(np.maximum(np.abs(gain), 1e-30))),
            "phase": filled(np.degrees(np.angle(gain))),
            "inter": filled(np.where(p.edge >= 0, 2, np.array([0, 1, 11])[p.order])), "inter_pos": filled(p.points_m),
        }  # fmt: skip
        for key, matrix in matrices.items():
            name = NAME.format(key=key, tx_set=TRANSMITTERS, tx=site, rx_set=RECEIVERS)
            np.savez_compressed(folder / f"{name}.npz", **{key: matrix})
    (folder / "params.json").write_text(json.dumps(_parameters(t, carrier_hz), indent=1), "utf-8")


def _parameters(t: Traced, carrier_hz: float) -> dict[str, Any]:
    def points(number: int, name: str, count: int) -> dict[str, Any]:
        sends = number == TRANSMITTERS
        return {
            "name": name, "id": number, "is_tx": sends, "is_rx": not sends, "num_points": count,
            "num_active_points": count, "num_ant": 1, "dual_pol": False, "ant_rel_positions": [[0.0, 0.0, 0.0]],
            "array_orientation": [0.0, 0.0, 0.0],
        }  # fmt: skip

    return {
        "version": "4.0.1",
        "rt_params": {
            "frequency": carrier_hz, "raytracer_name": "cellslam", "raytracer_version": "0.1",
            "max_path_depth": int(t.paths.order.max(initial=0)), "synthetic_array": True,
        },
        "txrx_sets": {
            "txrx_set_0": points(TRANSMITTERS, "transmitters", len(t.transmitters_m)),
            "txrx_set_1": points(RECEIVERS, "receivers", len(t.receivers_m)),
        },
        "materials": {},
        "scene": {"num_scenes": 1},
    }  # fmt: skip
