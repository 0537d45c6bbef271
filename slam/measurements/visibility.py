"""Virtual transmitters come and go: how likely one is visible so long after it was last detected.

Source: Musicki, Evans and Stankovic, "Integrated probabilistic data association", IEEE Trans. Automatic Control 39(6),
1994: existence as a Markov chain, and a miss by Bayes' rule.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.measurements.measurement_options import MeasurementOptions

HORIZON = 4096  # snapshots for which the chance of being visible is tabulated


def visibility(first: float, stay: float, back: float, detection: float, length: int) -> Floats:
    """Return P(visible) before the n-th snapshot since the last detection, (length,); entry 0 is unused: `first`.

    `first`: P(visible) just after the detection; `stay`, `back`: transition probabilities to visible.
    """
    out = np.empty(length)
    out[0] = r = first
    for n in range(1, length):
        out[n] = r = r * stay + (1.0 - r) * back
        r = r * (1.0 - detection) / (1.0 - r * detection)
    return out


def transitions(options: MeasurementOptions, interval_s: float) -> tuple[float, float]:
    """Return the probabilities that in an interval a visible VT stays so, and that a hidden one comes back."""
    return float(np.exp(-interval_s / options.visible_s)), float(-np.expm1(-interval_s / options.hidden_s))


def existence(options: MeasurementOptions, interval_s: float) -> tuple[Floats, int, int]:
    """Return log tables (2, 2, HORIZON) of P(visible and detected) and P(missed), and ages at which to drop VTs.

    First index: VTs detected once, others. A VT is visible or hidden, a two-state Markov chain; a visible one is
    detected with probability p_D; each miss lowers that by Bayes' rule. A VT that was seen once exists with the birth
    probability only, and does not come back: this is what makes a birth pay for itself.
    """
    o, (stay, back) = options, transitions(options, interval_s)
    once = visibility(o.birth_ratio, stay, 0.0, o.detection_probability, HORIZON)
    twice = visibility(1.0, stay, 0.0, o.detection_probability, HORIZON)
    known = visibility(1.0, stay, back, o.detection_probability, HORIZON)
    kept = [np.maximum(r, 1e-12) * o.detection_probability for r in (once, known)]
    table = np.stack([[np.log(r), np.log1p(-r)] for r in kept])
    ages = [int(np.argmax(np.append(r, 0.0) < o.drop_probability)) for r in (once, twice)]
    return table, ages[0], ages[1]
