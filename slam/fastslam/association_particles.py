"""FastSLAM with errors as states: particles of associations, each with one Gaussian of pose, VTs, clocks and errors."""

from __future__ import annotations

from typing import ClassVar

from cellslam.slam.ekf_slam.ekf_slam import JointFilter
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions


class AssociationParticles(JointFilter):
    """A mixture of joint filters: one becomes two where a measurement leaves a doubt that would move the vehicle or a
    clock, and two that agree become one.

    Sources: Doucet, de Freitas, Murphy and Russell, "Rao-Blackwellised particle filtering for dynamic Bayesian
    networks", UAI 2000; Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic Control 24(6), 1979;
    Fearnhead and Clifford, "On-line inference for hidden Markov models via particle filters", J. R. Statist. Soc. B
    65, 2003: what is drawn is discrete, so that the likeliest are kept instead of draws.
    """

    name: ClassVar[str] = "fastslam"
    options: FastSlamOptions

    @property
    def _most(self) -> int:
        return self.options.particles
