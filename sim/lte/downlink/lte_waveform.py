"""LTE as a waveform: the cell-specific reference signal of antenna ports 0 and 1 in the first symbol of every slot.

Source: 3GPP TS 36.211, clauses 6.10.1.2 (elements) and 6.12 (frequencies).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.lte.downlink.ofdm import SAMPLE_S, SUBCARRIER_SPACING_HZ, subcarrier_frequency_hz
from cellslam.sim.lte.downlink.reference_signals import SLOTS, first_subcarrier, reference_signal
from cellslam.sim.waveform.waveform import Complex, Floats, PortName

TONES_PER_RESOURCE_BLOCK = 2
RESOURCE_BLOCK_HZ = 180e3


@dataclass(frozen=True)
class LteWaveform:
    """A bandwidth of LTE. Ports are on six combs of every sixth subcarrier; those of colliding cells share one."""

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
        return tone_frequencies(self.resource_blocks)

    def combs(self, ports: Sequence[PortName]) -> list[int]:
        """Return the first reference subcarrier (n,) of each port in the first symbol, an index."""
        return [first_subcarrier(*port, 0, 0) for port in ports]

    def values(self, port: PortName, comb: int, slot: int) -> Complex:
        """Return the values (2 RB,), of magnitude 1 without unit, that a port sends in a slot of the frame."""
        return pilots(*port, slot, self.resource_blocks)[1]


def tone_frequencies(resource_blocks: int, first: int = 0) -> Floats:
    """Return baseband frequencies (2 RB,) in Hz of one port's reference tones: every sixth subcarrier from
    `first`, DC gap included (TS 36.211, 6.10.1.2 and 6.12).
    """
    k = first + 6 * np.arange(TONES_PER_RESOURCE_BLOCK * resource_blocks)
    return subcarrier_frequency_hz(k, resource_blocks)


def pilots(cell_id: int, port: int, slot: int, resource_blocks: int) -> tuple[NDArray[np.int64], Complex]:
    """Return subcarriers and values (2 N_RB,), of magnitude 1 without unit, of a port's reference signal in the first
    symbol of a slot that has it: symbol 0 for ports 0 and 1, symbol 1 for ports 2 and 3.
    """
    signal = reference_signal(cell_id, port, slot, resource_blocks)
    first = signal.symbols == signal.symbols[0]
    return signal.subcarriers[first], signal.values[first]
