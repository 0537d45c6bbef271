"""Whether a remembered map fits: a filter that begins with it is held against one beside it that does not.

Both filters have the same measurements; if the map is right, what it adds moves the estimate within what the filter
without it does not know. A vehicle or a clock that is elsewhere with the map than it can be without it refutes it, and
so do first measurements of its VTs that are farther off than its covariance says, and measurements that are hardly ever
of its VTs.

Sources: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 5.4,
for normalised innovations squared; Hausman, "Specification tests in econometrics", Econometrica 46(6), 1978, for the
two filters: an efficient estimate against one that is right even where the assumption is wrong. Here the sum of the
covariances is taken for that of the difference, which errs on the side of the map.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate

APART = 30.0  # squared deviations of their difference beyond which two estimates do not agree
LASTING = 20  # snapshots for which they do not, so that the map is rejected
FLOOR = np.array([0.1, 0.1, 0.005])  # what x, y (m) and yaw (rad) may differ by at any time
OFFSET_FLOOR_M = 0.5  # what clock offsets may
CHECKED_M = 100.0  # the check is over after such a distance with clock offsets that are known without the map, too
FEW, MANY = 50, 2000  # measurements after which a map is accepted, and after which it must be
LEAST_SHARE = 0.5  # of the measurements that are of the map's VTs
MOST_NIS = 4.0  # deviations by which the innovations squared of first measurements may exceed their mean
LEAST_COMPONENTS = 9.0  # of first measurements, by which a map may be rejected
PLANE = np.array([0, 1, 3])
WIDE = 0.3  # rad; where the heading is not known as well, a Gaussian does not say where the vehicle is


class MapCheck:
    """The check of a map whose VTs have the identities `ours`."""

    def __init__(self, ours: range) -> None:
        self._ours, self._distance_m, self._lasting = ours, 0.0, 0
        self._last: Floats | None = None
        self._measurements = self._known = 0
        self._nis = np.zeros(2)

    def take(
        self, with_map: Estimate, without: Estimate, nis: Floats, *, resolved: bool, resolved_without: bool
    ) -> None:
        """Take in what both filters answer to a snapshot; `nis` (2,): of first measurements of the map's VTs, as in
        `layout.Learnt`; `resolved`, `resolved_without`: whether each knows its clock offsets. Measurements with offsets
        that are not known are no evidence: the likeliest may be a wrong one."""
        self._nis = nis
        if self._last is not None and resolved_without:
            self._distance_m += float(np.linalg.norm(with_map.pose[:2] - self._last))
        self._last = with_map.pose[:2]
        if with_map.association is not None and resolved:
            of = with_map.association[with_map.association >= 0]
            self._measurements += len(of)
            self._known += int(((of >= self._ours.start) & (of < self._ours.stop)).sum())
        comparable = without.covariance[3, 3] < WIDE**2
        self._lasting = self._lasting + 1 if comparable and distance2(with_map, without) > APART else 0

    @property
    def _share(self) -> float:
        return self._known / max(self._measurements, 1)

    @property
    def rejected(self) -> str:
        """Why the map does not fit, in a line; empty: it may."""
        squares, count = self._nis
        why = ""
        if count >= LEAST_COMPONENTS and squares - count > MOST_NIS * np.sqrt(2.0 * count):
            why = f"first measurements of its VTs are {np.sqrt(squares / count):.1f} times as far off as they may be"
        elif self._lasting >= LASTING:
            why = "with it vehicle or clocks would be where they cannot be without it"
        elif self._measurements >= MANY and self._share < LEAST_SHARE:
            why = f"{self._share:.0%} of the measurements are of its VTs"
        return why and f"the map does not fit: {why}; the drive goes on without it"

    @property
    def accepted(self) -> bool:
        """Whether the map fits so far."""
        return self._measurements >= FEW and self._share >= LEAST_SHARE and not self.rejected

    @property
    def over(self) -> bool:
        """Whether the map has been checked for long enough."""
        return self._distance_m >= CHECKED_M and self._measurements >= MANY


def distance2(a: Estimate, b: Estimate) -> float:
    """Return the squared distance of two estimates, in its deviations: of place and yaw, or of the clock offset that is
    farthest off."""
    apart = (a.pose - b.pose)[PLANE]
    apart[2] = wrap_angle(apart[2])
    spread = (a.covariance + b.covariance)[np.ix_(PLANE, PLANE)] + np.diag(FLOOR**2)
    distances = [float(apart @ np.linalg.solve(spread, apart))]
    if a.clock_offset_m is not None and b.clock_offset_m is not None:
        assert a.clock_offset_variance_m2 is not None and b.clock_offset_variance_m2 is not None
        variance = a.clock_offset_variance_m2 + b.clock_offset_variance_m2 + OFFSET_FLOOR_M**2
        distances += ((a.clock_offset_m - b.clock_offset_m) ** 2 / variance).tolist()
    return max(distances)
