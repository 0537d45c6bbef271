"""Delay-direction spectrum of a link's samples: what the search of the path estimator looks at.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import Complex, Floats
from cellslam.sim.lte.signal.path_estimator import search_kernel
from cellslam.sim.lte.signal.path_estimator.joint_fit import Fit
from cellslam.sim.lte.signal.receiver import AZIMUTHS, ELEVATIONS, HIGHEST_RAD, LOWEST_RAD, Motion
from cellslam.sim.lte.statistical.detector_layout import DIFFUSE_SHARE
from cellslam.sim.recording import Ints

# Where diffuse energy of a path is expected: from so far behind it, to so far, and so many beams to its sides.
LEAD_M, TRAIL_M, BESIDE = 5.0, 150.0, 3
_BESIDE_RAD = (BESIDE + 0.5) * 2.0 * np.pi / AZIMUTHS
# By how much diffuse energy may be stronger in a cell than in those around it: it falls with delay, and fades.
DIFFUSE_MARGIN = 8.0


class Spectrum:
    """Beam outputs (2 K, D) and port outputs (ports, D) of the samples, fitted paths taken out; noise per sample.

    The samples are transformed once; paths are taken out of the transform, for they are of rank one there.
    """

    def __init__(self, y: Complex, motion: Motion) -> None:
        self.motion, self.receiver = motion, motion.receiver
        self._own_ports = y.astype(np.complex64) @ self.receiver.delay_matrix
        self._own_beams = motion.beams @ self._own_ports
        self.ports, self.beams = self._own_ports.copy(), self._own_beams.copy()
        count, bins = len(self.beams) // 2, self.beams.shape[1]
        self.power = search_kernel.PowerSpectrum(
            energy=np.empty((count, bins), np.float32), port_energy=np.empty(bins), noise=np.empty(bins),
            stretch=self.receiver.stretch_bins,
            trailing=np.zeros((AZIMUTHS, bins), np.float32), ports=int(np.count_nonzero(motion.factor)),
            elevations=ELEVATIONS,
        )  # fmt: skip
        self._update()

    def leave(self, fit: Fit | None) -> None:
        """Make this the spectrum of what the paths of a fit leave over."""
        self.power.trailing[:] = 0.0
        if fit is None:
            self.ports[:], self.beams[:] = self._own_ports, self._own_beams
        else:
            on_ports, delay = fit.in_spectrum
            np.subtract(self._own_ports, on_ports @ delay, out=self.ports)
            np.subtract(self._own_beams, (self.motion.beams @ on_ports) @ delay, out=self.beams)
            self.trail(fit)
        self._update()

    def subtract(self, fit: Fit, share: float = 1.0) -> None:
        """Take one more path out, in place; -1: put it back."""
        on_ports, delay = fit.in_spectrum
        on_ports = on_ports * np.float32(share)
        search_kernel.subtract_outer(self.ports, on_ports[:, 0], delay[0])
        search_kernel.subtract_outer(self.beams, self.motion.beams @ on_ports[:, 0], delay[0])
        self._update()

    def strongest(self, coarse: float, blocked: list[tuple[int, int]]) -> tuple[Floats, tuple[int, int], float] | None:
        """Return geometry (3,) in m, rad, rad, cell and level to exceed of the strongest cell that stands out; None:
        there is none.
        """
        cells = np.array(blocked, np.int64).reshape(-1, 2)
        k, d, level = search_kernel.strongest(self.power, coarse, cells, DIFFUSE_MARGIN)
        if k < 0:
            return None
        azimuth, elevation = self.receiver.directions
        return np.array([self.receiver.delays_m[d], azimuth[k], elevation[k]]), (k, d), level

    def levels(self, geometry: Floats, trailing: np.ndarray) -> tuple[Floats, Floats]:
        """Return the disturbance per sample (n,), an energy, around each of the paths that were taken out, and the
        level that it must have stood out of; `trailing` (n,): it lies where diffuse energy of a stronger path is
        expected.
        """
        out, asked = np.empty(len(geometry)), np.empty(len(geometry))
        rise = np.rint((geometry[:, 2] - LOWEST_RAD) / (HIGHEST_RAD - LOWEST_RAD) * (ELEVATIONS - 1)).astype(np.int64)
        direction = _column(geometry[:, 1]) % AZIMUTHS * ELEVATIONS + np.minimum(np.maximum(rise, 0), ELEVATIONS - 1)
        bins = np.minimum(np.maximum(self._bin(geometry[:, 0]), 0), len(self.receiver.delays_m) - 1)
        margin = np.where(trailing, DIFFUSE_MARGIN, 1.0)
        search_kernel.local_levels(direction, bins, self.power, margin, out, asked)
        return out, asked

    def in_trail(self, fit: Fit, cell: tuple[int, int]) -> bool:
        """Return whether a fitted cell is as weak as diffuse energy of a stronger path expected there."""
        return bool(fit.normal.explained < self.power.trailing[cell[0] // ELEVATIONS, cell[1]])

    def trail(self, fit: Fit) -> None:
        """Note where diffuse energy of paths is to be expected, and how much at most."""
        distance, energy = fit.geometry[:, 0], np.asarray(DIFFUSE_SHARE * fit.normal.wald, np.float32)
        first, last = self._bin(distance + LEAD_M), self._bin(distance + TRAIL_M) + 1
        search_kernel.note_trail(self.power.trailing, first, last, _column(fit.geometry[:, 1]), BESIDE, energy)

    def _bin(self, distance: Floats) -> Ints:
        return np.rint((distance - self.receiver.window_min_m) / self.receiver.pitch_m).astype(np.int64)

    def _update(self) -> None:
        self.noise: float = search_kernel.write_energies(self.beams, self.ports, self.power)


def _column(azimuth: Floats) -> Ints:
    """Return the column of the searched directions (n,) nearest to each azimuth, counted beyond a turn."""
    return np.rint((azimuth + np.pi) / (2.0 * np.pi) * AZIMUTHS).astype(np.int64)


def in_trail(geometry: Floats, energy: Floats) -> np.ndarray:
    """Return which paths (n,), of `geometry` (n, 3) in m, rad, rad, lie where diffuse energy of a stronger one is
    expected.
    """
    behind = geometry[:, None, 0] - geometry[None, :, 0]
    beside = np.abs(wrap_angle(geometry[:, None, 1] - geometry[None, :, 1])) < _BESIDE_RAD
    inside = (behind > LEAD_M) & (behind < TRAIL_M) & beside & (energy[:, None] < DIFFUSE_SHARE * energy[None, :])
    return np.asarray(inside.any(axis=1))
