"""The field of view of a front end, learnt from what it has measured: nothing is missed where nothing is ever seen.

Source: Mullane et al., "A random-finite-set approach to Bayesian SLAM", IEEE Trans. Robotics 27(2), 2011 (probability
of detection as a function of pose and place).
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.front_end.readings import Readings

UNKNOWN_M = 1e5  # reach of a front end that measures no distances


class FieldOfView:
    """Of each link the farthest distance (m) and the largest azimuth to either side (rad) measured so far, and the
    variances of both: `limits` (L, 4)."""

    def __init__(self, links: int) -> None:
        self.limits: Floats = np.tile([0.0, 0.0, 1.0, 1e-4], (links, 1))

    def widen(self, link: Ints, values: Readings) -> None:
        """Take the measurements of a snapshot, their links (m,), into account, in m and rad; a component that is not
        measured has no limit."""
        reach, span = np.nan_to_num(values.z[:, 0], nan=UNKNOWN_M), np.nan_to_num(np.abs(values.z[:, 1]), nan=np.pi)
        np.maximum.at(self.limits[:, 0], link, reach)
        np.maximum.at(self.limits[:, 1], link, span)
        self.limits[link, 2:] = values.single[:, :2]
