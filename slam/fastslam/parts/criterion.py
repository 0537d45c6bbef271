"""By what a pair of measurement and track is judged: parts of the filter."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellslam.slam.fastslam.parts.part_types import replaceable, variant
from cellslam.slam.fastslam.state.layout import LANES, O_SCORE, W_D2, W_DET, W_LOG, W_SCORE, Rows

B = LANES
LOG_2PI_3 = 1.5 * math.log(2.0 * math.pi)
NEVER = -1e30  # score of a pair that cannot be


class Likelihood(NamedTuple):
    """The pair's likelihood over that of a miss and clutter: r p_D N(e; 0, S) / (lambda_c (1 - r p_D))."""


class Mahalanobis(NamedTuple):
    """How far e^T S^-1 e is within the gate: the paper's criterion (section IV), which knows neither ln |S|, nor misses
    nor clutter."""


@replaceable
def score(part: Any, w: Rows, out: Rows, gate: float, lack: Any) -> None:
    """Write the pair's score at W_SCORE, which is positive where it should be associated; NEVER outside the gate and
    where the track's score is NEVER. `lack`: see `measurement_kernel.pack`."""
    F = w.dtype.type
    limit, rest = F(gate), F(lack - LOG_2PI_3)
    for l in range(B):
        value = out[O_SCORE * B + l] - F(0.5) * w[W_D2 * B + l] - F(0.5) * w[W_LOG * B + l] + rest
        inside = w[W_D2 * B + l] < limit and w[W_DET * B + l] > F(0.0) and out[O_SCORE * B + l] > -F(1e29)
        w[W_SCORE * B + l] = value if inside else F(NEVER)


@variant(score, Mahalanobis)
def _score(part: Mahalanobis, w: Rows, out: Rows, gate: float, lack: Any) -> None:
    """Score by distance."""
    F = w.dtype.type
    limit = F(gate)
    for l in range(B):
        inside = w[W_D2 * B + l] < limit and w[W_DET * B + l] > F(0.0) and out[O_SCORE * B + l] > -F(1e29)
        w[W_SCORE * B + l] = limit - w[W_D2 * B + l] if inside else F(NEVER)
