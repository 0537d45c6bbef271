"""Interference of a cell whose reference elements collide: both channels fitted within their delay windows.

Per array port, the descrambled tones are modelled as this cell's channel plus the other cell's, rescrambled, each
limited to a delay window; the other cell's part of the joint least-squares solution is subtracted. The channel of this
cell comes through without bias, for about 1.2 dB of noise.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import Complex, ComplexSingle
from cellslam.sim.recording import Ints
from cellslam.sim.waveform.waveform import PortName, Waveform

WINDOW_M = (-75.0, 695.0)
_KEPT = 1e-3  # singular values of the window's delay vectors, relative to the largest, that span its subspace
# Where the two cells' subspaces nearly meet, telling them apart would cost more noise than it removes interference.
_RIDGE = 1e-3


def cancel(
    y: ComplexSingle, waveform: Waveform, own: PortName, other: PortName, comb: int, slots: Ints, apart_m: float = 0.0
) -> ComplexSingle:
    """Return `y` (ports, tones), descrambled samples of port `own`, without what `other` on the same comb adds.

    `slots` (ports,): slot of the frame in which each array port is sampled; `apart_m`: by how many m later the
    other cell's window begins.
    """
    met, of, within = _places(tuple((slots % waveform.slots).tolist()))
    by_slot = np.zeros((len(met), within.max() + 1, y.shape[1]), np.complex64)
    by_slot[of, within] = y
    fit, back, turn = _operators(waveform, own, other, comb, met, apart_m)
    return y - (by_slot @ fit)[of, within] @ back * turn[of]


@lru_cache(maxsize=8)
def _places(slots: tuple[int, ...]) -> tuple[tuple[int, ...], Ints, Ints]:
    """Return the slots that are met, and where in an array (slots, most ports of a slot) each port stands: one product
    for all slots.
    """
    met, of, count = np.unique(slots, return_inverse=True, return_counts=True)
    order, within = np.argsort(of, kind="stable"), np.empty(len(of), np.int64)
    within[order] = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    return tuple(met.tolist()), of, within


@lru_cache(maxsize=64)
def _operators(
    waveform: Waveform, own: PortName, other: PortName, comb: int, slots: tuple[int, ...], apart_m: float
) -> tuple[ComplexSingle, ComplexSingle, ComplexSingle]:
    """Return the operators of several slots (slots, tones, r), (r, tones) and (slots, tones): see `_operator`."""
    each = (_operator(waveform, own, other, comb, slot, apart_m) for slot in slots)
    fit, turn = (np.stack(parts) for parts in zip(*each, strict=True))
    return fit, np.ascontiguousarray(_window_basis(waveform).T, np.complex64), turn


def _operator(
    waveform: Waveform, own: PortName, other: PortName, comb: int, slot: int, apart_m: float
) -> tuple[ComplexSingle, ComplexSingle]:
    """Return (tones, r), from samples to the other cell's coefficients, of which the basis makes its channel, and
    (tones,), from that to its samples.
    """
    basis = _window_basis(waveform)
    mine, theirs = (waveform.values(port, comb, slot) for port in (own, other))
    turn = mine.conj() * theirs * np.exp(-2j * np.pi * waveform.tones_hz * apart_m / SPEED_OF_LIGHT_MPS)
    both = np.concatenate([turn[:, None] * basis, basis], axis=1)
    gram = both.conj().T @ both + _RIDGE * np.eye(both.shape[1])
    coefficients = np.linalg.solve(gram, both.conj().T)[: basis.shape[1]]
    return np.ascontiguousarray(coefficients.T, np.complex64), turn.astype(np.complex64)


@lru_cache(maxsize=8)
def _window_basis(waveform: Waveform) -> Complex:
    """Return an orthonormal basis (tones, r) of the delay vectors within the window."""
    distance = np.arange(WINDOW_M[0], WINDOW_M[1], 4.0)
    vectors = np.exp(-2j * np.pi * np.outer(waveform.tones_hz, distance) / SPEED_OF_LIGHT_MPS)
    left, size, _ = np.linalg.svd(vectors, full_matrices=False)
    return np.asarray(left[:, size > _KEPT * size[0]], np.complex128)
