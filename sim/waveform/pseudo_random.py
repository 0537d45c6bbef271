"""The length-31 Gold sequence that LTE and NR share, and QPSK of its bits.

Source: 3GPP TS 36.211, clause 7.2, and TS 38.211, clause 5.2.1, which say the same.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_SEQUENCE_START = 1600  # N_C of both clauses
_REGISTER = 31


def gold_sequence(seed: int, length: int) -> NDArray[np.int8]:
    """Return the first bits (length,) of the length-31 Gold sequence with x2 seeded by `seed`, that is c_init."""
    state = np.array([(seed >> i) & 1 for i in range(_REGISTER)], np.int8)
    return _first_register(length) ^ _shift(state, (0, 1, 2, 3), length)


def qpsk(bits: NDArray[np.int8]) -> NDArray[np.complex128]:
    """Return values (n,) of magnitude 1 from bits (2 n,): ((1 - 2 c(2m)) + j (1 - 2 c(2m + 1))) / sqrt(2), weights
    without unit.
    """
    sign = 1.0 - 2.0 * bits.astype(np.float64)
    return np.asarray((sign[0::2] + 1j * sign[1::2]) / np.sqrt(2.0), np.complex128)


@lru_cache(maxsize=8)
def _first_register(length: int) -> NDArray[np.int8]:
    state = np.zeros(_REGISTER, np.int8)
    state[0] = 1
    return _shift(state, (0, 3), length)


def _shift(state: NDArray[np.int8], taps: tuple[int, ...], length: int) -> NDArray[np.int8]:
    """Return `length` bits after N_C of x(n + 31) = sum of x(n + tap) mod 2, from the first 31, `state`.

    With it holds, modulo 2, x(n + 31 s) = sum of x(n + s tap) for every power of two s: the more bits there are, the
    more follow in one step.
    """
    bits = np.empty(_SEQUENCE_START + length + _REGISTER, np.int8)
    bits[:_REGISTER] = state
    known, scale = _REGISTER, 1
    while known < len(bits):
        scale *= 2 if known >= 2 * scale * _REGISTER else 1
        count = min(scale * (_REGISTER - max(taps)), len(bits) - known)
        first = known - scale * _REGISTER
        new = bits[first : first + count].copy()
        for tap in taps[1:]:
            new ^= bits[first + scale * tap : first + scale * tap + count]
        bits[known : known + count] = new
        known += count
    return bits[_SEQUENCE_START : _SEQUENCE_START + length]
