"""Estimators that are shown part of the truth: what EKF-SLAM would reach if one of its problems were solved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cellslam.sim.recording import Ints, Truth
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.ekf_slam.bank import Bank
from cellslam.slam.ekf_slam.ekf_slam import EkfSlam
from cellslam.slam.ekf_slam.state.layout import KNOWN_ASSOCIATION, KNOWN_MAP
from cellslam.slam.front_end.looks import Looks

LONG_AGO = -100_000  # snapshot in which the map was last seen, at the start


class KnownAssociation(EkfSlam):
    """EKF-SLAM that is told which VT each measurement came from, and what is clutter."""

    name: ClassVar[str] = "oracle-association"
    requires_truth: ClassVar[bool] = True
    mode: ClassVar[int] = KNOWN_ASSOCIATION

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior and the associations."""
        self._vt_of = _truth(setup).measurement_vt
        super().start(setup, rng)

    def _given(self, looks: Looks) -> Ints:
        return np.array(self._vt_of[looks.row], np.int64)


class KnownMap(EkfSlam):
    """Localisation in the true map: every VT of the drive is known, clock offsets and associations are not."""

    name: ClassVar[str] = "oracle-map"
    requires_truth: ClassVar[bool] = True
    mode: ClassVar[int] = KNOWN_MAP

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior and the map."""
        self._truth = _truth(setup)
        super().start(setup, rng)

    def _map(self, filters: Sequence[tuple[Bank, int]]) -> VtEstimate | None:
        return None

    def _install(self, bank: Bank) -> None:
        """Put every VT of a link's site on that link."""
        vts = self._truth.vts
        link, vt = np.nonzero(self._setup.links.site[:, None] == vts.site)
        bank.know(link, vt, vts.position_m[vt], LONG_AGO)


def _truth(setup: Setup) -> Truth:
    if setup.truth is None:
        raise ValueError("an oracle needs a recording with truth")
    return setup.truth
