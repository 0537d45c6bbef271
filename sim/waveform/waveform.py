"""What a front end asks of a waveform, and whether one that is not built in gives it; reference signals.

Elements that carry reference signals are grouped into combs: two ports on one comb share all of its elements, two on
different combs none. A front end takes the elements that a port sends in one slot as simultaneous.

Source: own, docs/how-to/own-waveform.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
PortName = tuple[int, int]  # cell ID and antenna port
LONGEST_SLOT_S = 0.5e-3  # that the array listens to one of its ports
PORTS = ((1, 0), (2, 0))


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


def checked(given: Any, window_m: float) -> Waveform:
    """Return `given` if it is a waveform whose delays are unambiguous over a window in m. Raises InputError with what
    is wrong.
    """
    kind = type(given).__name__
    lacking = [name for name in vars(Waveform) if not name.startswith("_") and not hasattr(given, name)]
    if lacking:
        raise InputError(f"{kind} is no waveform: it lacks {', '.join(lacking)}")
    waveform: Waveform = given
    tones = np.asarray(waveform.tones_hz)
    steps = np.diff(tones)
    comb = waveform.combs(PORTS)[0]
    values = np.asarray(waveform.values(PORTS[0], comb, 0))
    reach_m = SPEED_OF_LIGHT_MPS / max(float(steps.max(initial=0.0)), 1e-9)
    for wrong, text in (
        (tones.ndim != 1 or len(tones) < 2 or (steps < 0.0).any(), "tones_hz are not two or more ascending numbers"),
        (np.ptp(tones) > waveform.bandwidth_hz, "tones_hz reach over more than bandwidth_hz"),
        (reach_m < window_m, f"tones are {steps.max(initial=0.0):.6g} Hz apart, so that delays repeat every "
                             f"{reach_m:.0f} m, within the search window of {window_m:g} m"),
        (waveform.slot_s > LONGEST_SLOT_S, f"slot_s = {waveform.slot_s:g} is longer than {LONGEST_SLOT_S:g}, in which "
                                           "the array listens to a port"),
        (values.shape != tones.shape, f"values have shape {values.shape}, tones_hz {tones.shape}"),
        (not np.allclose(np.abs(values), 1.0), "values are not all of magnitude 1"),
        (waveform.slots < 1, f"slots = {waveform.slots}: at least 1"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"waveform {kind}: {text}")
    return waveform


def check_integers(limits: dict[str, tuple[int, int, int]]) -> None:
    """Raise InputError for the first of named values, each with its least and greatest, that is out of its range."""
    for name, (value, low, high) in limits.items():
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise InputError(f"{name} {value} is not an integer from {low} to {high}")
