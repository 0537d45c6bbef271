"""What a front end asks of a waveform; reference signals as they are handed out.

Elements that carry reference signals are grouped into combs: two ports on one comb share all of its elements, two on
different combs none. A front end takes the elements that a port sends in one slot as simultaneous.

Source: own, docs/how-to/own-waveform.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
PortName = tuple[int, int]  # cell ID and antenna port


class ReferenceSignal(NamedTuple):
    """Reference elements of one port in one slot, by symbol, then subcarrier: all (N,).

    `symbols`: OFDM symbol in the slot; `subcarriers`: index from the first of the carrier's grid; `values`: complex, of
    magnitude 1.
    """

    symbols: NDArray[np.int64]
    subcarriers: NDArray[np.int64]
    values: NDArray[np.complex128]


class Waveform(Protocol):
    """A downlink signal: `radio.technology` names it. Hashable; two that are equal send the same."""

    def __hash__(self) -> int: ...

    @property
    def slot_s(self) -> float:
        """Length of a slot in s. An array port is sampled once within one."""
        ...

    @property
    def slots(self) -> int:
        """After how many slots `values` begin again."""
        ...

    @property
    def sample_s(self) -> float:
        """To what, in s, a receiver's search for cells places a site's delays."""
        ...

    @property
    def element_hz(self) -> float:
        """Bandwidth of a resource element in Hz: that of its noise."""
        ...

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth in Hz: it sets the resolution in delay."""
        ...

    @property
    def tones_hz(self) -> Floats:
        """Baseband frequencies (tones,) in Hz of the elements on comb 0, ascending."""
        ...

    @property
    def comb_step_hz(self) -> float:
        """By how much, in Hz, the elements on comb n + 1 lie above those on comb n."""
        ...

    def combs(self, ports: Sequence[PortName]) -> list[int]:
        """Return the comb, an index (n,), of each of all ports that are on the air; InputError if there are too few."""
        ...

    def values(self, port: PortName, comb: int, slot: int) -> Complex:
        """Return the values (tones,), of magnitude 1 without unit, that a port on a comb sends in a slot."""
        ...


def check_integers(limits: dict[str, tuple[int, int, int]]) -> None:
    """Raise InputError for the first of named values, each with its least and greatest, that is out of its range."""
    for name, (value, low, high) in limits.items():
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise InputError(f"{name} {value} is not an integer from {low} to {high}")
