"""Delay-direction spectrum of a link's samples: what the search of the path estimator looks at.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.lte.array import ComplexSingle
from cellslam.sim.lte.signal.path_estimator import search_kernel
from cellslam.sim.lte.signal.path_estimator.fit_kernel import Normal, factors
from cellslam.sim.lte.signal.path_estimator.search_kernel import Footprint, Outputs, PowerSpectrum
from cellslam.sim.lte.signal.receiver import AZIMUTHS, ELEVATIONS, Motion
from cellslam.sim.recording import Floats


class Spectrum:
    """Outputs, energies and noise of `samples` (ports, D), at the searched distances, fitted paths `taken` out.

    They are transformed once; paths are taken out of the transform, for they are of rank one there.
    """

    def __init__(self, samples: ComplexSingle, motion: Motion) -> None:
        self.samples, self.motion, self.receiver = samples, motion, motion.receiver
        beams = motion.beams @ self.receiver.by_set(samples)
        self.outputs = Outputs(beams.view(np.float32), samples.view(np.float32))
        count, bins = beams.shape[1:]
        self.power = PowerSpectrum(
            energy=np.empty((count, bins), np.float32), port_energy=np.empty(bins),
            noise=np.empty(bins), trailing=np.empty((AZIMUTHS, bins), np.float32), stretch=self.receiver.stretch_bins,
            ports=int(np.count_nonzero(motion.factor)), elevations=ELEVATIONS,
        )  # fmt: skip
        no_ports, no_tones = (np.empty((0, n), np.complex128) for n in (len(samples), len(self.receiver.rate)))
        self._nothing = search_kernel.footprint_of(no_ports, no_tones, motion.probe)
        self.leave_all()

    def leave_all(self) -> None:
        """Make this the spectrum of the samples as they are; energies wait until they are looked at."""
        self.power.trailing[:] = 0.0
        self._take(self._nothing)

    def leave(self, geometry: Floats, normal: Normal) -> None:
        """Make this the spectrum of what paths, fitted at `geometry` (n, 3), m, rad, rad, leave over."""
        self.power.trailing[:] = 0.0
        search_kernel.note_trail(geometry, normal.wald, self.motion.probe, self.power)
        self._take(search_kernel.footprint_of(*factors(geometry, normal.weights, self.motion.model), self.motion.probe))

    def _take(self, taken: Footprint) -> None:
        self.taken = taken
        self.noise = search_kernel.write_noise(self.outputs, taken, self.power)

    def evaluate(self) -> None:
        """Write all energies beside the paths that are taken out."""
        search_kernel.write_all_energies(*self.parts)

    @property
    def parts(self) -> tuple[Outputs, Footprint, PowerSpectrum]:
        """What the kernels take: outputs of the samples, paths taken out of them, energies."""
        return self.outputs, self.taken, self.power

    @property
    def residual(self) -> ComplexSingle:
        """The samples (ports, D) without what the paths taken out explain."""
        return np.asarray(self.samples - self.taken.on_ports.T.astype(np.complex64) @ self.taken.on_delays)
