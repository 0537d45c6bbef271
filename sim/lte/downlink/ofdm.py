"""OFDM symbols in time, DC gap included.

Source: the extended FastSLAM paper, equation 1; 3GPP TS 36.211, clause 6.12.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

SUBCARRIER_SPACING_HZ = 15e3
SYMBOL_S = 1.0 / SUBCARRIER_SPACING_HZ
SAMPLE_S = 1.0 / 30.72e6
# Cyclic prefix in units of SAMPLE_S (TS 36.211, Table 6.12-1).
_PREFIX = {"normal": (160, 144, 144, 144, 144, 144, 144), "extended": (512,) * 6}


def subcarrier_frequency_hz(subcarriers: ArrayLike, resource_blocks: int) -> NDArray[np.float64]:
    """Return the baseband frequency (n,) in Hz of subcarriers (n,), 0 to 12 N_RB - 1: the carrier is left out."""
    k, half = np.asarray(subcarriers, np.int64), 6 * resource_blocks
    return np.asarray(np.where(k < half, k - half, k - half + 1) * SUBCARRIER_SPACING_HZ, np.float64)


def baseband(
    values: ArrayLike, subcarriers: ArrayLike, time_s: ArrayLike, resource_blocks: int
) -> NDArray[np.complex128]:
    """Return the baseband signal (T,) of one OFDM symbol at `time_s` (T,), from -T_CP to T_s.

    `values` (N,) complex are what the `subcarriers` (N,) carry; the signal has their unit, times are in s.
    """
    frequency = subcarrier_frequency_hz(subcarriers, resource_blocks)
    phase = 2j * np.pi * np.outer(np.asarray(time_s, np.float64), frequency)
    return np.asarray(np.exp(phase) @ np.asarray(values, np.complex128), np.complex128)


def symbol_start_s(symbol: int, cyclic_prefix: str = "normal") -> float:
    """Return when the useful part of a symbol begins, counted from the start of its slot."""
    prefix = _PREFIX[cyclic_prefix]
    return sum(prefix[: symbol + 1]) * SAMPLE_S + symbol * SYMBOL_S
