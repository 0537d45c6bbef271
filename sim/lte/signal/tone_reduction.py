"""Fewer tones for the same delays: neighbouring tones added up, as many as the delay window allows.

The tones of a group are turned in phase for a path in the middle of the window, and added. Of a path elsewhere this
keeps the delay, and takes a factor from its amplitude that the fit takes for part of its weight.

Source: own, docs/how-to/own-waveform.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import Complex, Floats

MOST_LOSS_DB = 0.5  # of a path at the edge of the window
SHORTEST_WINDOW_M = 1750.0  # windows below this, the default, are taken for as long


@dataclass(frozen=True)
class ToneReduction:
    """Groups of `size` tones: phases (size,) that turn them, and the middle (groups,) of each, in Hz."""

    size: int
    turn: Complex
    tones_hz: Floats

    def of(self, y: Complex) -> Complex:
        """Return samples (ports, groups) of samples (ports, tones), noise per sample as there, in their unit."""
        if self.size == 1:
            return y
        return np.asarray(y.reshape(len(y), -1, self.size) @ self.turn / np.sqrt(self.size), np.complex128)


def reduction_of(tones_hz: Floats, window_min_m: float, window_max_m: float) -> ToneReduction:
    """Return the largest groups of tones (tones,), in Hz, that lose no more than MOST_LOSS_DB of any path of a window
    in m.
    """
    middle, half = 0.5 * (window_min_m + window_max_m), 0.5 * max(window_max_m - window_min_m, SHORTEST_WINDOW_M)
    best = ToneReduction(1, np.ones(1, np.complex128), tones_hz)
    for size in range(2, len(tones_hz) // 2 + 1):
        if len(tones_hz) % size:
            continue
        groups = tones_hz.reshape(-1, size)
        centres = groups.mean(axis=1)
        apart = 2.0 * np.pi * (groups - centres[:, None]) / SPEED_OF_LIGHT_MPS
        kept = np.abs(np.exp(1j * half * apart[0]).mean()) ** 2
        if kept < 10.0 ** (-MOST_LOSS_DB / 10.0):
            break
        if np.allclose(apart, apart[0], rtol=0.0, atol=1e-6 / half):
            best = ToneReduction(size, np.exp(1j * middle * apart[0]), centres)
    return best
