"""Cell-specific reference signals of LTE.

Source: 3GPP TS 36.211, clauses 6.10.1 (signals and their resource elements) and 7.2 (Gold sequence).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.waveform.pseudo_random import gold_sequence, qpsk
from cellslam.sim.waveform.waveform import ReferenceSignal

CyclicPrefix = Literal["normal", "extended"]
SYMBOLS_PER_SLOT = {"normal": 7, "extended": 6}
CELL_IDS, PORTS, SLOTS = 504, 4, 20
FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS = 6, 110


def reference_signal(
    cell_id: int,
    port: int,
    slot: int,
    resource_blocks: int = 100,
    cyclic_prefix: CyclicPrefix = "normal",
) -> ReferenceSignal:
    """Return the reference signal of a cell's antenna port in a slot of the frame (TS 36.211, 6.10.1).

    Raises InputError for a cell ID outside 0-503, port outside 0-3, slot outside 0-19, resource blocks
    outside 6-110 or an unknown prefix.
    """
    _check(cell_id, port, slot, resource_blocks, cyclic_prefix)
    rows = []
    for symbol in reference_symbols(port, cyclic_prefix):
        first = first_subcarrier(cell_id, port, slot, symbol)
        subcarriers = first + 6 * np.arange(2 * resource_blocks, dtype=np.int64)
        rows.append((np.full(2 * resource_blocks, symbol, np.int64), subcarriers))
    values = [_values(c_init(cell_id, slot, s[0], cyclic_prefix), resource_blocks) for s, _ in rows]
    symbols, subcarriers = (np.concatenate(column) for column in zip(*rows, strict=True))
    return ReferenceSignal(symbols, subcarriers, np.concatenate(values))


def reference_symbols(port: int, cyclic_prefix: CyclicPrefix = "normal") -> tuple[int, ...]:
    """Return the OFDM symbols of a slot that carry a port's reference signal (TS 36.211, 6.10.1.2)."""
    return (0, SYMBOLS_PER_SLOT[cyclic_prefix] - 3) if port < 2 else (1,)


def first_subcarrier(cell_id: int, port: int, slot: int, symbol: int) -> int:
    """Return the lowest reference subcarrier (v + v_shift) mod 6 of a port and symbol (TS 36.211,
    6.10.1.2).
    """
    if port >= 2:
        return (3 * (slot % 2) + 3 * (port - 2) + cell_id) % 6
    return ((0 if (port == 0) == (symbol == 0) else 3) + cell_id) % 6


def c_init(cell_id: int, slot: int, symbol: int | np.int64, cyclic_prefix: CyclicPrefix = "normal") -> int:
    """Return the seed of the pseudo-random sequence (TS 36.211, 6.10.1.1)."""
    n_cp = 1 if cyclic_prefix == "normal" else 0
    return 1024 * (7 * (slot + 1) + int(symbol) + 1) * (2 * cell_id + 1) + 2 * cell_id + n_cp


def colliding_ports(cell_a: int, cell_b: int, ports: int = 2) -> list[tuple[int, int]]:
    """Return the pairs (port of a, port of b) that share every reference element, frames being aligned.

    Two reference signals share their elements where they occupy the same symbols and start on the same
    subcarrier.
    """
    pairs = []
    for a in range(ports):
        for b in range(ports):
            same_symbols = reference_symbols(a) == reference_symbols(b)
            if same_symbols and all(
                first_subcarrier(cell_a, a, slot, s) == first_subcarrier(cell_b, b, slot, s)
                for slot in (0, 1)
                for s in reference_symbols(a)
            ):
                pairs.append((a, b))
    return pairs


@lru_cache(maxsize=1024)
def _pilot_bits(seed: int) -> NDArray[np.int8]:
    bits = gold_sequence(seed, 4 * MOST_RESOURCE_BLOCKS)
    bits.setflags(write=False)
    return bits


def _values(seed: int, resource_blocks: int) -> NDArray[np.complex128]:
    """Return r(m') for m' = m + 110 - N_RB: QPSK of bit pairs, centred in the widest band (6.10.1.1-2)."""
    start = MOST_RESOURCE_BLOCKS - resource_blocks
    return qpsk(_pilot_bits(seed)[2 * start : 2 * (start + 2 * resource_blocks)])


def _check(cell_id: int, port: int, slot: int, resource_blocks: int, cyclic_prefix: str) -> None:
    limits = {
        "cell ID": (cell_id, 0, CELL_IDS - 1),
        "antenna port": (port, 0, PORTS - 1),
        "slot": (slot, 0, SLOTS - 1),
        "resource_blocks": (resource_blocks, FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS),
    }
    for name, (value, low, high) in limits.items():
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise InputError(f"{name} {value} is not an integer from {low} to {high}")
    if cyclic_prefix not in SYMBOLS_PER_SLOT:
        raise InputError(f"cyclic prefix '{cyclic_prefix}' is unknown (normal, extended)")
