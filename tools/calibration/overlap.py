"""Detection probability of each path of a sample as the statistical front end computes it, in NumPy.

Source: own derivation, studies/front-end-calibration.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ncx2

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.error_bounds import bound_scales
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.waveform import Waveform
from tools.calibration.scenes import Sample

_TABLE_DB = np.arange(-20.0, 70.0, 0.1)


class Relations(NamedTuple):
    """What the paths of a sample are to each other.

    Of every pair of a path and a stronger one on its link that disturbs it (N,): row of the `path`, how much later (m)
    and beside (rad) it is, integrated SNR of the `stronger` one. Of every path (P,): what stronger ones leave of it,
    and whether the rule for ghosts strikes it out.
    """

    path: Ints
    behind: Floats
    beside: Floats
    stronger: Floats
    leftover: Floats
    ghost: NDArray[np.bool_]


class Law(NamedTuple):
    """Logistic of crowded paths in dB, disturbance by stronger paths (log10), sidelobes (log10), their width in m."""

    centre_db: float
    width_db: float
    log_trail: float
    log_around: float
    log_sidelobes: float
    sidelobe_m: float


def relations(sample: Sample, waveform: Waveform) -> Relations:
    """Return the relations of all paths of a sample."""
    pairs, leftover, ghost = [], np.ones(len(sample.link)), np.zeros(len(sample.link), np.bool_)
    for link in np.unique(sample.link):
        rows = np.flatnonzero(sample.link == link)
        geometry, gamma = sample.geometry[rows], 10.0 ** (sample.gamma_db[rows] / 10.0)
        apart = geometry[:, None] - geometry[None]
        apart[..., 1] = wrap_angle(apart[..., 1])
        stronger, near = gamma[None, :] > gamma[:, None], np.abs(apart[..., 0])
        leftover[rows] = np.prod(1.0 - captured(apart, geometry, waveform) * (near < k.NEIGHBOUR_M) * stronger, axis=1)
        ghost[rows] = ((near < k.GHOST_REACH_M) & (gamma[:, None] < 10.0**-2.5 * gamma[None, :])).any(axis=1)
        i, j = np.nonzero(gamma[:, None] < k.DIFFUSE_SHARE * gamma[None, :])
        pairs.append(np.column_stack([rows[i], apart[i, j, :2], gamma[j]]))
    path, behind, beside, stronger_gamma = np.concatenate(pairs).T
    return Relations(path.astype(np.int64), behind, beside, stronger_gamma, leftover, ghost)


def captured(apart: Floats, geometry: Floats, waveform: Waveform) -> Floats:
    """Return the share of a path's energy in the tangent space of another, for all pairs (n, n)."""
    scales = bound_scales(waveform)
    cosine = np.cos(0.5 * (geometry[:, None, 2] + geometry[None, :, 2])) ** k.AZIMUTH_EXPONENT
    s = (
        (apart[..., 0] / scales.distance_m) ** 2
        + (apart[..., 1] * cosine / scales.azimuth_rad) ** 2
        + (apart[..., 2] / scales.elevation_rad) ** 2
    )
    return np.asarray(np.exp(-s) * (1.0 + s), np.float64)


def chances(
    sample: Sample, of: Relations, ratio_db: float, detection: tuple[float, float], threshold: float, law: Law
) -> Floats:
    """Return the detection probability (P,) of each path of a sample; `detection` is (dof, gain)."""
    fall = 10.0**law.log_sidelobes / (1.0 + (of.behind / law.sidelobe_m) ** 2)
    diffuse = (of.behind >= 0.0) & (of.behind <= k.DIFFUSE_TO_M)
    fall = fall + np.where(diffuse, np.exp(-np.maximum(of.behind, 0.0) / k.TRAIL_DECAY_M), 0.0)
    toward = 10.0**law.log_trail * np.exp(-0.5 * (of.beside / k.TRAIL_BESIDE_RAD) ** 2) + 10.0**law.log_around
    energy = np.bincount(of.path, of.stronger * fall * toward, minlength=len(sample.link))
    disturbance = 1.0 + 10.0 ** (-ratio_db / 10.0) * energy
    gamma_db = sample.gamma_db + 10.0 * np.log10(np.maximum(of.leftover, 1e-12) / disturbance)
    table = ncx2.sf(2.0 * threshold, detection[0], detection[1] * 10.0 ** (_TABLE_DB / 10.0))
    crowded = 1.0 / (1.0 + np.exp(-np.clip((gamma_db - law.centre_db) / law.width_db, -50.0, 50.0)))
    isolated = (of.leftover > k.ISOLATED_LEFTOVER) & (disturbance < k.DISTURBED)
    return np.asarray(np.where(isolated, np.interp(gamma_db, _TABLE_DB, table), crowded) * ~of.ghost)
