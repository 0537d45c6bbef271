"""Estimators that are given part of the truth: what a filter would reach if one of its problems were solved.

State, prediction, update and weight are those of the filter that each is made of. What is given takes the place of

    oracle-association  `associate` of EKF-SLAM: a measurement is of its true VT, clutter of none   `KnownAssociation`
    oracle-fastslam     the parts association, birth and pruning of FastSLAM, in the same way
                                                                                           `FastSlamKnownAssociation`
    oracle-map          the births of EKF-SLAM: the true VTs v of every link are known from the start, with covariance
                        zero; clock offsets and associations are estimated                                 `KnownMap`
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cellslam.sim.recording import Ints, Truth
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.fastslam_kernel import Scores
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts import never
from cellslam.slam.joint.ekf_slam import EkfSlam, JointFilter
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.snapshot.association_kernel import FRESH
from cellslam.slam.joint.state.layout import IDENT, KNOWN_ASSOCIATION, KNOWN_MAP, LINK, Filter, Measured
from cellslam.slam.measurements.fusion import FusedMeasurements

LONG_AGO = -100_000  # snapshot in which the map was last seen, at the start


class GivenAssociations(JointFilter):
    """A joint filter that is given which VT each measurement came from, and what is clutter."""

    requires_truth: ClassVar[bool] = True
    mode: ClassVar[int] = KNOWN_ASSOCIATION

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior and the associations."""
        self._vt_of = _truth(setup).measurement_vt
        super().start(setup, rng)

    def _surveyed_idents(self, link: Ints) -> Ints:
        truth = _truth(self._setup)
        vt = truth.site_vts[self._setup.links.site[link]]
        return np.where(vt >= 0, vt, len(truth.vts) + link)  # of which no path exists: no measurement is of it

    def _given(self, measurements: FusedMeasurements) -> Ints:
        return np.array(self._vt_of[measurements.row], np.int64)


class KnownAssociation(GivenAssociations, EkfSlam):
    """EKF-SLAM that is given the true associations."""

    name: ClassVar[str] = "oracle-association"


class FastSlamKnownAssociation(GivenAssociations, FastSlam):
    """FastSLAM that is given the true associations."""

    name: ClassVar[str] = "oracle-fastslam"

    def __init__(self, options: FastSlamOptions | None = None) -> None:
        super().__init__(options)
        self.parts = self.parts._replace(pruning=never)

    def _hypotheses(self, f: Filter, measured: Measured, scores: Scores) -> list[Ints]:
        link = np.repeat(np.arange(len(measured.first) - 1), np.diff(measured.first))
        known = f.vts.slots[: int(f.count[0])]
        same = (known[:, IDENT] == measured.given[:, None]) & (known[:, LINK] == link[:, None])
        return [np.where(same.any(axis=1), same.argmax(axis=1) if len(known) else 0, FRESH)]


class KnownMap(EkfSlam):
    """Localisation in the true map: mirror images of the drive are known, clock offsets and associations are not."""

    name: ClassVar[str] = "oracle-map"
    requires_truth: ClassVar[bool] = True
    mode: ClassVar[int] = KNOWN_MAP

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior and the map."""
        self._truth = _truth(setup)
        super().start(setup, rng)

    def _map(self, filters: Sequence[tuple[Mixture, int]]) -> VtEstimate | None:
        return None

    def _install(self, mixture: Mixture) -> None:
        """Put every VT of a link's site on that link, but scatterers."""
        vts = self._truth.vts
        link, vt = np.nonzero((self._setup.links.site[:, None] == vts.site) & ~vts.scatters)
        mixture.know(link, vt, vts.position_m[vt], np.zeros((len(vt), 3)), LONG_AGO)

    def _refuted_surveys(self) -> list[str]:
        return []  # the true map is in the place of the surveys


def _truth(setup: Setup) -> Truth:
    if setup.truth is None:
        raise ValueError("an oracle needs a recording with truth")
    return setup.truth
