"""Fewer tones for the same delays: tones filtered to the delay window, and every so many-th of the result kept.

A filter over neighbouring tones takes a factor from a path's amplitude that depends on its delay, and that the fit
takes for part of its weight; the delay stays. Tones in even steps are filtered with a root-raised-cosine, which keeps
noise white and the window flat, at the price of tones at the ends of the band. Else those of a group are added up.

Source: own, docs/how-to/own-waveform.md; root-raised-cosine: Proakis, "Digital communications", 2001, section 9.2.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import Complex, ComplexSingle, Floats

MOST_LOSS_DB = 0.5  # of a path at the edge of the window
SHORTEST_WINDOW_M = 1750.0  # windows below this, the default, are taken for as long
FILTER_STEPS = 8  # length of the filter in kept tones
LEAST_ROLL_OFF = 0.25  # that so short a filter can have
MOST_TRIMMED = 0.025  # share of the band that a filter may take off its ends


@dataclass(frozen=True)
class ToneReduction:
    """Every `size`-th tone of those filtered with `taps` (a multiple of `size`); `tones_hz` (groups,) that are kept."""

    size: int
    taps: Complex
    tones_hz: Floats

    def of(self, y: Complex | ComplexSingle) -> Complex | ComplexSingle:
        """Return samples (ports, groups) of samples (ports, tones), noise per sample as there, in their unit."""
        if self.size == 1:
            return y
        parts = y.reshape(len(y), -1, self.size) @ self.taps.reshape(-1, self.size).T
        count, out = len(self.tones_hz), parts[:, : len(self.tones_hz), 0].copy()
        for step in range(1, parts.shape[2]):
            out += parts[:, step : step + count, step]
        return np.asarray(out, np.complex128)


def reduction_of(tones_hz: Floats, window_min_m: float, window_max_m: float) -> ToneReduction:
    """Return the reduction to fewest tones, of `tones_hz` (tones,), that loses no more than MOST_LOSS_DB of any path of
    a window in m.
    """
    middle, half = 0.5 * (window_min_m + window_max_m), 0.5 * max(window_max_m - window_min_m, SHORTEST_WINDOW_M)
    summed, filtered = _summed(tones_hz, middle, half), _filtered(tones_hz, middle, half)
    return min(filtered, summed, key=lambda reduction: len(reduction.tones_hz))


def _summed(tones_hz: Floats, middle: float, half: float) -> ToneReduction:
    """Return the largest groups of tones that may be added up, in phase for a path in the middle of the window."""
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
            best = ToneReduction(size, np.exp(1j * middle * apart[0]) / np.sqrt(size), centres)
    return best


def _filtered(tones_hz: Floats, middle: float, half: float) -> ToneReduction:
    """Return the reduction by a filter whose pass band is the window; size 1 where there is none."""
    best, count = ToneReduction(1, np.ones(1, np.complex128), tones_hz), len(tones_hz)
    step_hz = float(np.ptp(tones_hz)) / (count - 1)
    if not np.allclose(np.diff(tones_hz), step_hz, rtol=1e-9, atol=0.0):
        return best
    for size in range(2, int(MOST_TRIMMED * count) // FILTER_STEPS + 1):
        roll_off = 1.0 - 2.0 * half * size * step_hz / SPEED_OF_LIGHT_MPS
        if count % size == 0 and roll_off >= LEAST_ROLL_OFF:
            place = np.arange(FILTER_STEPS * size) - 0.5 * (FILTER_STEPS * size - 1)
            shape = root_raised_cosine(place / size, min(roll_off, 1.0))
            turn = np.exp(2j * np.pi * middle * place * step_hz / SPEED_OF_LIGHT_MPS)
            middles = np.arange(count // size - FILTER_STEPS + 1) * size + 0.5 * (FILTER_STEPS * size - 1)
            best = ToneReduction(size, shape / np.linalg.norm(shape) * turn, tones_hz[0] + middles * step_hz)
    return best


def root_raised_cosine(place: Floats, roll_off: float) -> Floats:
    """Return the filter (n,), without unit, at `place` (n,) in kept tones from its middle; 0 < `roll_off` <= 1."""
    t = np.asarray(place, np.float64)
    # Where its closed form is 0 / 0, a place beside it has the value to 1e-6.
    t = np.where(np.isclose(t, 0.0) | np.isclose(np.abs(t), 0.25 / roll_off), t + 1e-6, t)
    above = np.sin(np.pi * t * (1.0 - roll_off)) + 4.0 * roll_off * t * np.cos(np.pi * t * (1.0 + roll_off))
    return np.asarray(above / (np.pi * t * (1.0 - (4.0 * roll_off * t) ** 2)), np.float64)
