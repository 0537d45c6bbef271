"""Estimators that are shown part of the truth: what EKF-SLAM would reach if one of its problems were solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from cellslam.sim.recording import Floats, Ints, Truth
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.ekf_slam.bank import Bank
from cellslam.slam.ekf_slam.ekf_slam import EkfSlam
from cellslam.slam.ekf_slam.state.layout import (
    HITS,
    IDENT,
    KNOWN_ASSOCIATION,
    KNOWN_MAP,
    LAST,
    LINK,
    SHARE,
    VT,
    VT_STATES,
)
from cellslam.slam.ekf_slam.state.states_kernel import owner_of
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.parts.association import FromTruth
from cellslam.slam.fastslam.parts.choice import Choice
from cellslam.slam.front_end.looks import Looks

LONG_AGO = -100_000  # snapshots since a known VT was last seen, at the start


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


class FastSlamKnownAssociation(FastSlam):
    """FastSLAM that is told which VT each measurement came from, and what is clutter."""

    name: ClassVar[str] = "oracle-fastslam"
    requires_truth: ClassVar[bool] = True

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior, and take the associations."""
        self.choice = self._told(_truth(setup).measurement_vt)
        super().start(setup, rng)

    def _told(self, measurement_vt: Ints) -> Choice:
        return replace(self.choice, parts=self.choice.parts._replace(association=FromTruth(measurement_vt)))


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
        """Put every VT of a link's site on that link, without uncertainty."""
        vts = self._truth.vts
        pairs = [
            (link, vt) for link, site in enumerate(self._setup.links.site) for vt in np.flatnonzero(vts.site == site)
        ]
        bank.reserve(3 * len(pairs), len(pairs))
        f, first, here = bank.arrays, bank.core.size, self._setup.start_pose[:3]
        f.count[:], f.size[:] = len(pairs), first + 3 * len(pairs)
        for j, (link, vt) in enumerate(pairs):
            f.slots[:, j, [LINK, HITS, LAST, IDENT]] = link, 1000, LONG_AGO, vt
            f.anchor[:, j, :3], f.anchor[:, j, SHARE] = here, 1.0
            at = first + 3 * j + np.arange(3)
            f.vt_state[:, j], f.vt_state[:, j, VT : VT + 3] = -1, at
            f.owner[:, at] = [owner_of(j, VT + c, VT_STATES) for c in range(3)]
            f.x[:, at] = _spherical(vts.position_m[vt] - here)


def _spherical(vector: Floats) -> Floats:
    """Return length, azimuth and elevation (3,)."""
    flat = np.hypot(vector[0], vector[1])
    return np.array([np.hypot(flat, vector[2]), np.arctan2(vector[1], vector[0]), np.arctan2(vector[2], flat)])


def _truth(setup: Setup) -> Truth:
    if setup.truth is None:
        raise ValueError("an oracle needs a recording with truth")
    return setup.truth
