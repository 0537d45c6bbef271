"""NR as a waveform: one positioning reference signal a port, its symbols used jointly.

Within a resource the comb is moved from symbol to symbol until every subcarrier has been hit, so that the elements of
one slot, in the order of their subcarriers, are evenly spaced tones without ambiguity up to 1 / (subcarrier spacing).
The channel is taken to stand still for the slot. The signal is sent in every slot: period 32 at 15 kHz, repetition 32.

Source: 3GPP TS 38.211, clause 7.4.1.7; use of the symbols: own, docs/how-to/own-waveform.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.nr.prs import (
    SUBCARRIERS_PER_BLOCK,
    check_comb,
    check_resource_blocks,
    positioning_reference_signal,
    slots_per_frame,
)
from cellslam.sim.waveform.waveform import Complex, Floats, PortName, check_integers

PORTS_PER_CELL = 4
LONGEST_FFT = 4096


@dataclass(frozen=True)
class NrWaveform:
    """Bandwidth, numerology and comb of the positioning reference signals of all cells, each port on an offset of its
    own. Numerology 0 is too slow: its slots are longer than an array port is listened to.
    """

    resource_blocks: int = 272
    numerology: int = 1
    comb: int = 12
    symbols: int = 12

    comb_step_hz = 0.0  # every comb reaches every subcarrier

    def __post_init__(self) -> None:
        check_integers({"numerology": (self.numerology, 1, 3)})
        check_resource_blocks(self.resource_blocks)
        check_comb(self.comb, self.symbols)

    @property
    def element_hz(self) -> float:
        """Subcarrier spacing in Hz."""
        return float(15e3 * 2**self.numerology)

    @property
    def slot_s(self) -> float:
        """Length of a slot in s."""
        return float(1e-3 / 2**self.numerology)

    @property
    def slots(self) -> int:
        """Slots of a frame."""
        return slots_per_frame(self.numerology)

    @property
    def sample_s(self) -> float:
        """Sampling interval in s of the widest carrier of this numerology."""
        return 1.0 / (LONGEST_FFT * self.element_hz)

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth in Hz."""
        return self.resource_blocks * SUBCARRIERS_PER_BLOCK * self.element_hz

    @cached_property
    def tones_hz(self) -> Floats:
        """Frequencies (tones,) in Hz about the middle of the band, 12 a block, each as often as it is sent."""
        count = self.resource_blocks * SUBCARRIERS_PER_BLOCK
        subcarriers = np.repeat(np.arange(count), self.symbols // self.comb)
        return np.asarray((subcarriers - 0.5 * (count - 1)) * self.element_hz, np.float64)

    def combs(self, ports: Sequence[PortName]) -> list[int]:
        """Return the element offset (n,), an index, of each port: one after another. Raises InputError where there are
        fewer offsets than ports.
        """
        if len(ports) > self.comb:
            raise InputError(
                f"{len(ports)} ports share a comb of {self.comb}: those on one offset would have to be muted in turn, "
                "which is not modelled; set radio.prs_comb to 12, or fewer cells or ports"
            )
        return list(range(len(ports)))

    def values(self, port: PortName, comb: int, slot: int) -> Complex:
        """Return the values (tones,), of magnitude 1 without unit, by subcarrier, then symbol."""
        return _values(self, port, comb, slot)


@lru_cache(maxsize=1024)
def _values(waveform: NrWaveform, port: PortName, comb: int, slot: int) -> Complex:
    cell_id, number = port
    signal = positioning_reference_signal(
        PORTS_PER_CELL * cell_id + number, slot, waveform.numerology, waveform.resource_blocks, waveform.comb,
        waveform.symbols, element_offset=comb,
    )  # fmt: skip
    values = signal.values[np.argsort(signal.subcarriers, kind="stable")]
    values.setflags(write=False)
    return values
