"""Delay-direction spectrum of a link's samples: what the search of the path estimator looks at.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.lte.array import Complex, Floats
from cellslam.sim.lte.signal.path_estimator import search_kernel
from cellslam.sim.lte.signal.path_estimator.joint_fit import Fit
from cellslam.sim.lte.signal.path_estimator.search_kernel import DIFFUSE_MARGIN, Footprint, Outputs, PowerSpectrum
from cellslam.sim.lte.signal.receiver import AZIMUTHS, ELEVATIONS, Motion


class Spectrum:
    """Outputs, energies and noise of the samples (ports, tones), fitted paths `taken` out.

    The samples are transformed once; paths are taken out of the transform, for they are of rank one there.
    """

    def __init__(self, y: Complex, motion: Motion) -> None:
        self.motion, self.receiver = motion, motion.receiver
        on_ports = y.astype(np.complex64) @ self.receiver.delay_matrix
        beams = motion.beams @ self.receiver.by_set(on_ports)
        self.outputs = Outputs(beams.view(np.float32), on_ports.view(np.float32))
        count, bins = beams.shape[1:]
        self.power = PowerSpectrum(
            energy=np.empty((count, bins), np.float32), peak=np.empty(bins, np.float32), port_energy=np.empty(bins),
            noise=np.empty(bins), trailing=np.empty((AZIMUTHS, bins), np.float32), stretch=self.receiver.stretch_bins,
            ports=int(np.count_nonzero(motion.factor)), elevations=ELEVATIONS,
        )  # fmt: skip
        nothing = np.empty((0, self.receiver.array.ports), np.complex128), np.empty((0, y.shape[1]), np.complex128)
        self._nothing = search_kernel.footprint_of(*nothing, motion.probe)
        self.leave(None)

    def leave(self, fit: Fit | None) -> None:
        """Make this the spectrum of what the paths of a fit leave over; energies wait until they are looked at."""
        self.power.trailing[:] = 0.0
        self.taken: Footprint = self._nothing
        if fit is not None:
            self.taken = search_kernel.footprint_of(*fit.factors, self.motion.probe)
            search_kernel.note_trail(fit.geometry, fit.normal.wald, self.motion.probe, self.power)
        search_kernel.write_noise(self.outputs, self.taken, self.power)
        self.noise = float(np.median(self.power.noise))

    @property
    def parts(self) -> tuple[Outputs, Footprint, PowerSpectrum]:
        """What the kernels take: outputs of the samples, paths taken out of them, energies."""
        return self.outputs, self.taken, self.power

    def look(self, taken: Footprint) -> None:
        """Write all energies beside the paths that are taken out."""
        search_kernel.write_all_energies(self.outputs, taken, self.power)

    def strongest(self, coarse: float, blocked: np.ndarray) -> tuple[Floats, tuple[int, int], float] | None:
        """Return geometry (3,) in m, rad, rad, cell and level to exceed of the strongest cell that stands out and is
        not near those of `blocked` (B, 2); None: there is none.
        """
        k, d, level = search_kernel.strongest(self.power, coarse, blocked, DIFFUSE_MARGIN)
        if k < 0:
            return None
        azimuth, elevation = self.receiver.directions
        return np.array([self.receiver.delays_m[d], azimuth[k], elevation[k]]), (k, d), level
