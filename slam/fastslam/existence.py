"""How likely a VT is to be visible, as a function of how long it has not been seen.

A VT is visible or hidden, a two-state Markov chain with mean times `visible_s` and `hidden_s`; a visible one is
detected with
probability p_D. The snapshot after a detection it is visible but for the chance of hiding; each miss lowers that by
Bayes' rule. A VT
that was seen once exists with the birth probability only, and does not come back: this is what makes a birth pay for
itself
(deferred credit) without a counter of its own. Since the probability depends on the number of misses alone, it is a
table and
nothing need be written for a VT that is not seen.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.options import FastSlamOptions

HORIZON = 4096


def visibility(first: float, stay: float, back: float, detection: float, length: int) -> Floats:
    """Return P(visible) before the n-th snapshot since the last detection, n = 0..length-1 (entry 0 is unused:
    `first`).

    `first`: P(visible) just after the detection; `stay`, `back`: transition probabilities to visible.
    """
    out = np.empty(length)
    out[0] = r = first
    for n in range(1, length):
        out[n] = r = r * stay + (1.0 - r) * back
        r = r * (1.0 - detection) / (1.0 - r * detection)
    return out


def tables(options: FastSlamOptions, interval_s: float) -> tuple[Floats, int, int]:
    """Return the log tables (2, 2, HORIZON) and the ages (snapshots) at which unconfirmed VTs are dropped.

    First index: VTs seen once, others; second: log P(visible and detected), log P(missed).
    """
    stay, back = np.exp(-interval_s / options.visible_s), -np.expm1(-interval_s / options.hidden_s)
    p_d = options.detection_probability
    once = visibility(options.birth_ratio, stay, 0.0, p_d, HORIZON)
    twice = visibility(1.0, stay, 0.0, p_d, HORIZON)
    known = visibility(1.0, stay, back, p_d, HORIZON)
    once_kept = np.maximum(once, 1e-12)
    out = np.stack([[np.log(r * p_d), np.log1p(-r * p_d)] for r in (once_kept, known)])
    return out, _age_below(once, options.drop_probability), _age_below(twice, options.drop_probability)


def _age_below(r: Floats, limit: float) -> int:
    below = np.flatnonzero(r < limit)
    return int(below[0]) if len(below) else HORIZON
