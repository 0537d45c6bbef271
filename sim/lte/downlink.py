"""What LTE sends: the cell-specific reference signals, and these as a waveform.

The carrier itself is left out of a symbol: between subcarriers 6 N_RB - 1 and 6 N_RB there is a gap of one.

Source: 3GPP TS 36.211, clauses 6.10.1 (reference signals and their resource elements), 6.12 (OFDM symbols: what is left
out) and 7.2 (Gold sequence).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.waveform.pseudo_random import gold_sequence, qpsk
from cellslam.sim.waveform.waveform import Complex, Floats, PortName, ReferenceSignal, check_integers

CyclicPrefix = Literal["normal", "extended"]
SYMBOLS_PER_SLOT = {"normal": 7, "extended": 6}
CELL_IDS, PORTS, SLOTS = 504, 4, 20
FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS = 6, 110
SUBCARRIER_SPACING_HZ = 15e3
RESOURCE_BLOCK_HZ = 180e3
SAMPLE_S = 1.0 / 30.72e6


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
    check_integers({
        "cell ID": (cell_id, 0, CELL_IDS - 1),
        "antenna port": (port, 0, PORTS - 1),
        "slot": (slot, 0, SLOTS - 1),
        "resource_blocks": (resource_blocks, FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS),
    })  # fmt: skip
    if cyclic_prefix not in SYMBOLS_PER_SLOT:
        raise InputError(f"cyclic prefix '{cyclic_prefix}' is unknown (normal, extended)")
    symbols, step = reference_symbols(port, cyclic_prefix), 6 * np.arange(2 * resource_blocks, dtype=np.int64)
    subcarriers = [first_subcarrier(cell_id, port, slot, symbol) + step for symbol in symbols]
    # r(m') for m' = m + 110 - N_RB: QPSK of bit pairs, centred in the widest band (6.10.1.1-2).
    start = 2 * (MOST_RESOURCE_BLOCKS - resource_blocks)
    bits = [_pilot_bits(c_init(cell_id, slot, symbol, cyclic_prefix)) for symbol in symbols]
    values = [qpsk(one[start : start + 4 * resource_blocks]) for one in bits]
    number = np.repeat(np.array(symbols, np.int64), 2 * resource_blocks)
    return ReferenceSignal(number, np.concatenate(subcarriers), np.concatenate(values))


def reference_symbols(port: int, cyclic_prefix: CyclicPrefix = "normal") -> tuple[int, ...]:
    """Return the OFDM symbols of a slot that carry a port's reference signal (TS 36.211, 6.10.1.2)."""
    return (0, SYMBOLS_PER_SLOT[cyclic_prefix] - 3) if port < 2 else (1,)


def first_subcarrier(cell_id: int, port: int, slot: int, symbol: int) -> int:
    """Return the lowest reference subcarrier (v + v_shift) mod 6 of a port and symbol (TS 36.211, 6.10.1.2)."""
    if port >= 2:
        return (3 * (slot % 2) + 3 * (port - 2) + cell_id) % 6
    return ((0 if (port == 0) == (symbol == 0) else 3) + cell_id) % 6


def c_init(cell_id: int, slot: int, symbol: int, cyclic_prefix: CyclicPrefix = "normal") -> int:
    """Return the seed of the pseudo-random sequence (TS 36.211, 6.10.1.1)."""
    n_cp = 1 if cyclic_prefix == "normal" else 0
    return 1024 * (7 * (slot + 1) + symbol + 1) * (2 * cell_id + 1) + 2 * cell_id + n_cp


@lru_cache(maxsize=1024)
def _pilot_bits(seed: int) -> NDArray[np.int8]:
    bits = gold_sequence(seed, 4 * MOST_RESOURCE_BLOCKS)
    bits.setflags(write=False)
    return bits


def subcarrier_frequency_hz(subcarriers: ArrayLike, resource_blocks: int) -> Floats:
    """Return the baseband frequency (n,) in Hz of subcarriers (n,), 0 to 12 N_RB - 1: the carrier is left out."""
    k, half = np.asarray(subcarriers, np.int64), 6 * resource_blocks
    return np.asarray(np.where(k < half, k - half, k - half + 1) * SUBCARRIER_SPACING_HZ, np.float64)


@dataclass(frozen=True)
class LteWaveform:
    """A bandwidth of LTE: the reference signals of antenna ports 0 and 1 in the first symbol of every slot. Ports are
    on six combs of every sixth subcarrier; those of colliding cells share one.
    """

    resource_blocks: int = 100

    slot_s = 0.5e-3
    slots = SLOTS
    sample_s = SAMPLE_S
    element_hz = SUBCARRIER_SPACING_HZ
    comb_step_hz = SUBCARRIER_SPACING_HZ

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth in Hz."""
        return self.resource_blocks * RESOURCE_BLOCK_HZ

    @cached_property
    def tones_hz(self) -> Floats:
        """Frequencies (2 RB,) in Hz of the comb whose first subcarrier is 0."""
        return subcarrier_frequency_hz(6 * np.arange(2 * self.resource_blocks), self.resource_blocks)

    def combs(self, ports: Sequence[PortName]) -> list[int]:
        """Return the first reference subcarrier (n,) of each port in the first symbol, an index."""
        return [first_subcarrier(*port, 0, 0) for port in ports]

    def values(self, port: PortName, comb: int, slot: int) -> Complex:
        """Return the values (2 RB,), of magnitude 1 without unit, that a port sends in the first symbol of a slot."""
        return reference_signal(*port, slot, self.resource_blocks).values[: 2 * self.resource_blocks]
