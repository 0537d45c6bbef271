"""Delay-direction spectrum of a link's samples: what the search of the path estimator looks at.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.lte.array import ComplexSingle
from cellslam.sim.lte.signal.path_estimator import search_kernel
from cellslam.sim.lte.signal.path_estimator.fit_kernel import NO_NORMAL, Normal
from cellslam.sim.lte.signal.path_estimator.search_kernel import Footprint, PowerSpectrum
from cellslam.sim.lte.signal.receiver import AZIMUTHS, ELEVATIONS, Motion
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.recording import Floats


class Spectrum:
    """Energies and noise of `samples` (ports, D), at the searched distances, fitted paths `taken` out: `residual`.

    They are transformed to beams once; paths are taken out of the transform, for they are of rank one there.
    """

    def __init__(self, samples: ComplexSingle, motion: Motion) -> None:
        self.samples, self.residual, self.motion, receiver = samples, np.empty_like(samples), motion, motion.receiver
        beams = motion.beams @ receiver.by_set(samples)
        self.on_beams = beams.view(np.float32)
        count, bins = beams.shape[1:]
        self.power = PowerSpectrum(
            energy=np.empty((count, bins), np.float32), port_energy=np.empty(bins),
            noise=np.empty(bins), trailing=np.empty((AZIMUTHS, bins), np.float32), stretch=receiver.stretch_bins,
            ports=int(np.count_nonzero(motion.factor)), elevations=ELEVATIONS,
        )  # fmt: skip
        self.leave(np.empty((0, 3)), NO_NORMAL)

    def leave(self, geometry: Floats, normal: Normal) -> None:
        """Make this the spectrum of what paths, fitted at `geometry` (n, 3), m, rad, rad, leave over; energies wait
        until they are looked at.
        """
        taken, self.noise = search_kernel.leave(
            self.samples, geometry, normal, self.residual, self.power, self.motion.probe, self.motion.model
        )
        self.taken = Footprint(*taken)

    def evaluate(self) -> None:
        """Write all energies beside the paths that are taken out."""
        search_kernel.write_all_energies(*self.parts)

    @property
    def parts(self) -> tuple[Array, Footprint, PowerSpectrum]:
        """What the kernels take: what the samples give the beams, paths taken out of them, energies."""
        return self.on_beams, self.taken, self.power
