"""Two things that may be one: how likely that is, and what it teaches a joint filter.

If they are one, they differ by no more than how flat facades are, and by their covariance in the joint state. Otherwise
they differ by anything. The posterior odds of the two decide. What is believed is imposed as a measurement of zero,
once: the joint filter then is one whose landmark is the wall.

Sources: Simon, "Kalman filtering with state constraints", IET Control Theory and Applications 4(8), 2010, section 2.3,
for constraints as measurements; Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE
Trans. Automatic Control 38, 1993.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.snapshot.gauge_kernel import carry_over
from cellslam.slam.ekf_slam.state.layout import Filter

GATE = 9.0  # squared Mahalanobis distance of what may be one
ITERATIONS = 3


class Gap(NamedTuple):
    """By what two things differ, `value` (2,), and its Jacobian `by` (2, n) by the states that are `at` (n,)."""

    value: Floats
    at: Ints
    by: Floats


def log_odds(f: Filter, gap: Gap, spread: Floats, room: float) -> float:
    """Return the log-odds that two things are one, of a gap with the variance `spread` (2, 2); -inf beyond the gate.

    room: area, in the gap's units, over which two things differ, if they are not one.
    """
    s = gap.by @ f.p[np.ix_(gap.at, gap.at)] @ gap.by.T + spread
    distance2 = float(gap.value @ np.linalg.solve(s, gap.value))
    if distance2 > GATE:
        return -math.inf
    return -0.5 * distance2 - 0.5 * math.log(np.linalg.det(s)) - math.log(2.0 * math.pi) + math.log(room)


def impose(f: Filter, measure: Callable[[Filter], Gap], spread: Floats) -> None:
    """Let a filter know that two things are one: an iterated update by a gap of zero, with the variance `spread`."""
    n, before = int(f.size[0]), f.x.copy()
    for _ in range(ITERATIONS):
        gap = measure(f)
        root, gains = _gains(f, gap, spread)
        left = -gap.value - gap.by @ (before[gap.at] - f.x[gap.at])
        f.x[:n] = before[:n] + np.linalg.solve(root, left) @ gains
    carry_over(f, before, np.empty((4, len(before))))
    _, gains = _gains(f, measure(f), spread)
    f.p[:n, :n] -= gains.T @ gains


def _gains(f: Filter, gap: Gap, spread: Floats) -> tuple[Any, Any]:
    """Return the root (2, 2) of the gap's covariance, and what it says of the states, whitened by that (2, N)."""
    hp = gap.by @ f.p[gap.at, : f.size[0]]
    root = np.linalg.cholesky(hp[:, gap.at] @ gap.by.T + spread)
    return root, np.linalg.solve(root, hp)
