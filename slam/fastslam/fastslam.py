"""FastSLAM: particles whose VTs are Gaussian, with errors that persist as states or counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cellslam.sim.compiling import is_compiled
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.ekf_slam.ekf_slam import JointFilter
from cellslam.slam.ekf_slam.sizes import Sizes
from cellslam.slam.ekf_slam.snapshot import snapshot_kernel
from cellslam.slam.fastslam.association_particles import AssociationParticles
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.vt_map import VtMap


class FastSlam:
    """Rao-Blackwellised particle filter: what a particle is given, the rest is Gaussian in it.

    With errors as states a particle is a sequence of associations, with a mode of the clock offsets, and pose, VTs and
    errors are one Gaussian in it. With errors counted it is a path, as in the paper, and every VT is a Gaussian of its
    own; parts of that filter can be replaced.

    Sources: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
    information"; Doucet, de Freitas, Murphy and Russell, "Rao-Blackwellised particle filtering for dynamic Bayesian
    networks", UAI 2000.
    """

    name: ClassVar[str] = "fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[FastSlamOptions]] = FastSlamOptions

    def __init__(self, options: FastSlamOptions | None = None, **parts: Any) -> None:
        """Take options, and parts as objects where they are not those that the options name, with errors counted.

        parts: association, criterion, clock, resampling; see `part_types`, `resampling`.
        """
        self.options = options or FastSlamOptions()
        counted = self.options.errors == "counted"
        if parts and not counted:
            raise TypeError(f"{', '.join(sorted(parts))}: a part of the filter with errors='counted'; set that option")
        self._filter: PathParticles | JointFilter = (
            PathParticles(self.options, **parts) if counted else AssociationParticles(self.options)
        )

    @staticmethod
    def compiled() -> bool:
        """Return whether the kernels of errors as states have been compiled before, and are in Numba's cache."""
        return is_compiled(snapshot_kernel.__name__, Path(snapshot_kernel.__file__))

    def warm_up(self) -> None:
        """Compile every kernel on a made-up drive."""
        self._filter.warm_up()

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior. Raises InputError for a map with errors counted."""
        if setup.map is not None and isinstance(self._filter, PathParticles):
            raise InputError("a map, but with errors=counted fastslam begins with none: set errors=states")
        self._filter.start(setup, rng)

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Answer a snapshot.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        return self._filter.step(dt_s, odometry, snapshot)

    def sizes(self) -> Sizes:
        """Return what the drive so far says of the sizes of errors, with errors as states.

        Raises RuntimeError while the clock offsets are wide, and with errors counted.
        """
        if isinstance(self._filter, PathParticles):
            raise RuntimeError("sizes are learnt with errors='states' alone")
        return self._filter.sizes()

    def remarks(self) -> list[str]:
        """Return what the drive says against the sizes of errors that the filter was told; none with errors counted."""
        return [] if isinstance(self._filter, PathParticles) else self._filter.remarks()

    def vt_map(self) -> VtMap | None:
        """Return the map that the drive leaves; None with errors counted."""
        return None if isinstance(self._filter, PathParticles) else self._filter.vt_map()

    def calibration(self) -> Calibration | None:
        """Return the array's calibration as the drive has shown it; None with errors counted."""
        return None if isinstance(self._filter, PathParticles) else self._filter.calibration()
