"""WALL-SLAM: EKF-SLAM that knows that VTs of several sites may be images in one wall, and that maps the walls.

State, prediction, update and weight are those of EKF-SLAM (ekf_slam.py). Between blocks:
    sites       of a link's VTs the one that is nearest from where the others were seen    walls/images.py: images_of
    walls       the plane that mirrors site p to image v: azimuth of v - p, distance of (v + p) / 2 along it
                                                                                           walls/joining.py: planes_of
    one wall?   e = difference of two planes, S = H P H^T + R: log N(e; 0, S) + log ROOM >= log join_odds
                                                                                           best_pair
    if so       a measurement e = 0 with covariance R updates the state, once                 impose
    two walls?  e = image of an image in a second wall - v, judged and imposed alike          walls/doubles.py
    report      a wall is the Gauss-Markov mean of the planes of its images                   walls/facades.py: estimate
    association none with VTs whose walls, as far as they were seen, the path would miss      not_met
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import Field

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, WallEstimate
from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.start import Start
from cellslam.slam.joint.state.layout import BEYOND, IDENT, LAST, Filter, Measured, one_of
from cellslam.slam.joint.walls.facades import Facades
from cellslam.slam.joint.walls.joining import Flatness

JOINED_EVERY, SHOWN_EVERY, LOOKED_EVERY = 64, 16, 16  # snapshots
NO_WALLS = WallEstimate(
    np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2))
)  # fmt: skip


class WallSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.wall-slam`."""

    join_odds: float = Field(
        150.0, ge=1, le=1e9, description="odds from which on two VTs are taken for images in one wall; 1e9: never"
    )
    facade_turned_deg: float = Field(0.5, gt=0, le=10, description="by how much parts of one wall are turned, deg")
    facade_off_m: float = Field(0.3, gt=0, le=10, description="by how much parts of one wall are set off, m")
    facade_gap_m: float = Field(10.0, ge=0, le=1000, description="longest gap between parts of one wall, m")


class WallSlam(JointFilter):
    """The joint filter of EKF-SLAM; that two VTs are images in one wall is a measurement, once it is sure."""

    name: ClassVar[str] = "wall-slam"
    Options: ClassVar[type[WallSlamOptions]] = WallSlamOptions

    def __init__(self, options: WallSlamOptions | None = None) -> None:
        self.options: WallSlamOptions = options or WallSlamOptions()

    def _join(self, offsets_m: Floats) -> None:
        o = self.options
        flat = Flatness(math.radians(o.facade_turned_deg), o.facade_off_m, o.facade_gap_m)
        self._facades, self._joined, self._shown, self._looked = Facades(flat, math.log(o.join_odds)), 0, 0, 0
        super()._join(offsets_m)

    def _see(self, association: Ints, place: Floats) -> None:
        super()._see(association, place)
        for ident in association[association >= 0].tolist():
            self._facades.see(ident, place)

    def _use(self, interval: Interval, measured: Measured) -> Ints:
        if measured.now >= self._looked + LOOKED_EVERY:
            self._end_walls(measured)
        association = super()._use(interval, measured)
        mixture = self._joint
        # Between blocks, when no measurements wait for the state that they were held against; of a mixture none is
        # changed.
        between = mixture is not None and len(mixture) == 1 and not mixture.blocks.snapshots[0, 0]
        if mixture is not None and between and measured.now >= self._joined + JOINED_EVERY:
            self._facades.join(one_of(mixture.arrays, 0))
            self._joined = measured.now
        return association

    def _end_walls(self, measured: Measured) -> None:
        """Let nothing be associated with VTs, unseen for a while, whose walls would not be met as far as they reach."""
        self._looked, mixture = measured.now, self._joint
        if mixture is not None:
            missed, slots = self._facades.not_met(likeliest(mixture)), mixture.arrays.slots
            long_ago = measured.now - slots[..., LAST] > measured.rules.association.away
            slots[..., BEYOND] = np.isin(slots[..., IDENT], missed) & long_ago

    def _step_start(self, start: Start, interval: Interval, measured: Measured) -> Estimate:
        return replace(super()._step_start(start, interval, measured), walls=NO_WALLS)

    def _step_joint(self, interval: Interval, measured: Measured) -> Estimate:
        answer, mixture = super()._step_joint(interval, measured), self._joint
        if mixture is None or measured.now < self._shown + SHOWN_EVERY:
            return answer
        self._shown = measured.now
        return replace(answer, walls=self._facades.estimate(likeliest(mixture), self.options.confirm_hits))


def likeliest(mixture: Mixture) -> Filter:
    """Return the likeliest filter of a mixture."""
    return one_of(mixture.arrays, int(np.argmax(mixture.log_weight)))
