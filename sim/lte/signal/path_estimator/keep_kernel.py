"""Compiled judgement of a joint fit's paths: the disturbance around each, and which of them stay.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal, inverse_information
from cellslam.sim.lte.signal.path_estimator.search_kernel import (
    BESIDE,
    DIFFUSE_MARGIN,
    LEAD_M,
    TRAIL_M,
    Footprint,
    Outputs,
    PowerSpectrum,
    Probe,
    cell_of,
    local_level,
    neighbours,
    write_energies,
)
from cellslam.sim.lte.statistical.detector_layout import DIFFUSE_SHARE, GHOST_REACH_M, Array


class Demands(NamedTuple):
    """What a path must fulfil: `threshold` over the level that it must stand out of, `suspect_margin` times as much
    where it has less than `suspect_share` of one within reach, more than `ghost_share`; deviations below `reliable`
    (3,) in m, rad, rad; `lowest` and `highest` (3,) geometry. `touching_m`: within which dropping one may save another.
    """

    threshold: float
    suspect_share: float
    suspect_margin: float
    ghost_share: float
    reliable: Array
    lowest: Array
    highest: Array
    touching_m: float


@njit(cache=True, nogil=True)
def judged(
    geometry: Array, normal: Normal, outputs: Outputs, taken: Footprint, spectrum: PowerSpectrum, probe: Probe,
    demands: Demands,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the disturbance per sample (n,) around each path of a fit, whose paths are those taken out, and which
    paths (n,) stay: of those that fall short, the weakest within reach of each other goes. Energies are written where
    they are looked at.
    """
    n, energy, distance = len(geometry), normal.wald, geometry[:, 0]
    level, statistic, bad = np.empty(n), np.empty(n), np.zeros(n, np.bool_)
    beside_rad = (BESIDE + 0.5) * 2.0 * math.pi / len(spectrum.trailing)
    for i in range(n):
        trailing, suspect = False, False
        for j in range(n):
            behind, share = distance[i] - distance[j], energy[i] / max(energy[j], 1e-300)
            beside = abs(wrap(geometry[i, 1] - geometry[j, 1])) < beside_rad
            trailing |= LEAD_M < behind < TRAIL_M and beside and share < DIFFUSE_SHARE
            suspect |= abs(behind) < GHOST_REACH_M and share < demands.suspect_share
            bad[i] |= abs(behind) < GHOST_REACH_M and share < demands.ghost_share
        k, d = cell_of(geometry[i], probe, spectrum)
        write_energies(outputs, taken, neighbours(k, spectrum), spectrum)
        level[i], asked = local_level(k, d, 0.0, spectrum, DIFFUSE_MARGIN if trailing else 1.0)
        statistic[i] = energy[i] / asked
        bad[i] |= statistic[i] < demands.threshold * (demands.suspect_margin if suspect else 1.0)
        for c in range(3):
            bad[i] |= geometry[i, c] < demands.lowest[c] or geometry[i, c] > demands.highest[c]
    inverse = inverse_information(normal.information)
    for i in range(n):
        for c in range(3):
            variance = inverse[3 * i + c, 3 * i + c] * level[i]
            bad[i] |= not 0.0 < variance < demands.reliable[c] ** 2
    kept = np.ones(n, np.bool_)
    for i in np.argsort(statistic):
        kept[i] = not bad[i] or bool((~kept & (np.abs(distance - distance[i]) <= demands.touching_m)).any())
    return level, kept
