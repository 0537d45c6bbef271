"""A waveform of one's own: every `STEP`-th of evenly spaced tones carries a pilot, each port on tones of its own.

With this file on Python's path: cellslam run lund-530 --set radio.technology=pilot_tones:PilotTones --set radio.front_end=signal
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

STEP, SPACING_HZ, SUBCARRIERS = 12, 7.5e3, 2400  # pilots every 90 kHz: delays are unambiguous up to 3.3 km


@dataclass(frozen=True)  # hashable, equal to its like
class PilotTones:
    """18 MHz of subcarriers; random signs that change from slot to slot."""

    radio: object  # the scenario's [radio], for keys that one wants to read

    slot_s = 0.5e-3  # an array port is sampled once in 0.5 ms: no longer than that
    slots = 10
    sample_s = 1.0 / 40e6
    element_hz = SPACING_HZ
    bandwidth_hz = SUBCARRIERS * SPACING_HZ
    comb_step_hz = SPACING_HZ

    @cached_property
    def tones_hz(self):
        return (STEP * np.arange(SUBCARRIERS // STEP) - SUBCARRIERS // 2) * SPACING_HZ

    def combs(self, ports):
        return [number % STEP for number in range(len(ports))]

    def values(self, port, comb, slot):
        rng = np.random.default_rng([*port, slot])
        return (1.0 - 2.0 * rng.integers(0, 2, len(self.tones_hz))).astype(np.complex128)
