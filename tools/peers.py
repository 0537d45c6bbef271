"""Other ray tracers, asked so that they answer as fully as they can: Sionna RT and DiffeRT, where installed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.rays.paths import Floats, Ints

SIONNA_VARIANT = "llvm_ad_mono_polarized"
SIONNA_SAMPLES = 100_000
# A receiver's share of the table in which Sionna RT keeps candidates; with its default paths vanish silently.
SIONNA_TABLE = 20_000_000


@dataclass(frozen=True)
class PeerPaths:
    """Paths (P,) that a peer found, copies included: receiver, order, length, angles of arrival, seconds taken.

    `point_m` (P, 3): where the path is reflected first, NaN on a line of sight; `gain` (P, 2, 2) complex: amplitudes
    between (H, V) polarisations, receiver by transmitter; None: not asked for.
    """

    receiver: Ints
    order: Ints
    length_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    point_m: Floats
    gain: NDArray[np.complex128] | None
    seconds: float

    def __len__(self) -> int:
        return len(self.receiver)


Ask = Callable[[Path, Floats, Floats, int], PeerPaths]


def unavailable(name: str) -> str | None:
    """Return why a peer cannot be asked, or None if it can."""
    try:
        if name == "Sionna RT":
            import mitsuba

            mitsuba.set_variant(SIONNA_VARIANT)
            import drjit

            drjit.eval(drjit.llvm.ad.Float([1.0]) + 1.0)
        elif name == "DiffeRT":
            import differt.geometry  # noqa: F401
    except ImportError as error:
        return f"{name} is not installed ({error})"
    except Exception as error:
        return f"{name} does not start ({' '.join(str(error).split())[:120]}); it needs LLVM (Debian: libllvm19)"
    return None


def ask_sionna(scene_xml: Path, transmitter: Floats, receivers: Floats, max_order: int) -> PeerPaths:
    """Return what Sionna RT finds from one transmitter (3,) to receivers (N, 3), ground reflections included.

    The time is that of the second call; the first one, to a few receivers, compiles.
    """
    import mitsuba

    mitsuba.set_variant(SIONNA_VARIANT)
    _solve_sionna(scene_xml, transmitter, receivers[:20], max_order)
    return _solve_sionna(scene_xml, transmitter, receivers, max_order)


def _solve_sionna(scene_xml: Path, transmitter: Floats, receivers: Floats, max_order: int) -> PeerPaths:
    import sionna.rt as rt

    scene = rt.load_scene(str(scene_xml))
    scene.frequency = 2.66e9
    scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="VH")
    scene.add(rt.Transmitter("transmitter", position=[float(c) for c in transmitter]))
    for index, place in enumerate(receivers):
        scene.add(rt.Receiver(f"receiver {index}", position=[float(c) for c in place]))
    start = time.perf_counter()
    found = rt.PathSolver()(
        scene, max_depth=max_order, los=True, specular_reflection=True, diffuse_reflection=False, refraction=False,
        samples_per_src=SIONNA_SAMPLES, max_num_paths_per_src=SIONNA_TABLE,
    )  # fmt: skip
    delay = np.array(found.tau)[:, 0]
    seconds = time.perf_counter() - start
    return _sionna_paths(found, delay, seconds)


def _sionna_paths(found: Any, delay: Floats, seconds: float) -> PeerPaths:
    rows, columns = np.nonzero(np.array(found.valid)[:, 0] & (delay >= 0.0))
    real, imaginary = (np.array(part, np.float64) for part in found.a)
    # Theirs is (V, H); the sign of V is that of falling elevation, of H that of growing azimuth.
    amplitude = (real + 1j * imaginary)[rows, :, 0, :, columns][:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    order = (np.array(found.interactions)[:, rows, 0, columns] > 0).sum(axis=0)
    bent = np.where(order[:, None] > 0, np.array(found.vertices, np.float64)[0, rows, 0, columns], np.nan)
    return PeerPaths(
        receiver=rows.astype(np.int64),
        order=order.astype(np.int64),
        length_m=delay[rows, columns].astype(np.float64) * SPEED_OF_LIGHT_MPS,
        azimuth_rad=np.array(found.phi_r, np.float64)[rows, 0, columns],
        elevation_rad=np.pi / 2 - np.array(found.theta_r, np.float64)[rows, 0, columns],
        point_m=bent,
        gain=amplitude,
        seconds=seconds,
    )


def ask_differt(scene_xml: Path, transmitter: Floats, receivers: Floats, max_order: int) -> PeerPaths:
    """Return what DiffeRT's default solver finds from one transmitter (3,) to receivers (N, 3).

    The time is that of the third call: the first one compiles, and the second one has been seen to do so too.
    """
    import equinox
    import jax.numpy as jnp
    from differt.geometry import Scene

    ends = jnp.asarray(transmitter, jnp.float32).reshape(1, 3), jnp.asarray(receivers, jnp.float32)
    scene = equinox.tree_at(lambda s: (s.transmitters, s.receivers), Scene.load_xml(str(scene_xml)), ends)
    pieces: list[tuple[Ints, int, Floats]] = []
    total = 0.0
    for order in range(max_order + 1):
        for _ in range(3):
            start = time.perf_counter()
            found = scene.trace_paths(order=order)
            mask, vertices = np.array(found.mask), np.array(found.vertices, np.float64)
            seconds = time.perf_counter() - start
        total += seconds
        _, row, column = np.nonzero(mask)
        pieces.append((row, order, vertices[0, row, column]))
    return _differt_paths(pieces, total)


def _differt_paths(pieces: list[tuple[Ints, int, Floats]], seconds: float) -> PeerPaths:
    length, azimuth, elevation, bent = [], [], [], []
    for _, order, corners in pieces:
        bent.append(corners[:, 1] if order else np.full((len(corners), 3), np.nan))
        length.append(np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1))
        x, y, z = (corners[:, -2] - corners[:, -1]).T
        azimuth.append(np.arctan2(y, x))
        elevation.append(np.arctan2(z, np.hypot(x, y)))
    return PeerPaths(
        receiver=np.concatenate([row for row, _, _ in pieces]).astype(np.int64),
        order=np.concatenate([np.full(len(row), order) for row, order, _ in pieces]).astype(np.int64),
        length_m=np.concatenate(length),
        azimuth_rad=np.concatenate(azimuth),
        elevation_rad=np.concatenate(elevation),
        point_m=np.concatenate(bent),
        gain=None,
        seconds=seconds,
    )


PEERS: Mapping[str, Ask] = {"Sionna RT": ask_sionna, "DiffeRT": ask_differt}
