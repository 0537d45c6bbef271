"""Detection probability of each path of a sample as the statistical front end computes it, in NumPy.

Source: own derivation, docs/notes/front-end-calibration.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import ncx2

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.calibration.scenes import Sample
from cellslam.sim.lte.single_path_bound import AZIMUTH_EXPONENT, bound_scales
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.recording import Floats
from cellslam.sim.waveform import Waveform

_TABLE_DB = np.arange(-20.0, 70.0, 0.1)


class Relations(NamedTuple):
    """What the paths of one link are to each other: rows of the sample (n,), how much later and beside (n, n), the
    integrated SNR of those so strong that they disturb it (n, n), leftover and ghost rule (n,).
    """

    rows: np.ndarray
    behind: Floats
    beside: Floats
    disturbing: Floats
    leftover: Floats
    ghost: np.ndarray


class Law(NamedTuple):
    """Logistic of crowded paths in dB, disturbance by stronger paths (log10), sidelobes (log10), their width in m."""

    centre_db: float
    width_db: float
    log_trail: float
    log_around: float
    log_sidelobes: float
    sidelobe_m: float


def relations(sample: Sample, waveform: Waveform) -> list[Relations]:
    """Return the relations of all links of a sample."""
    out = []
    for link in np.unique(sample.link):
        rows = np.flatnonzero(sample.link == link)
        geometry, gamma = sample.geometry[rows], 10.0 ** (sample.gamma_db[rows] / 10.0)
        apart = geometry[:, None] - geometry[None]
        apart[..., 1] = wrap_angle(apart[..., 1])
        stronger = gamma[None, :] > gamma[:, None]
        disturbing = gamma[:, None] < k.DIFFUSE_SHARE * gamma[None, :]
        near = np.abs(apart[..., 0])
        leftover = np.prod(1.0 - captured(apart, geometry, waveform) * (near < k.NEIGHBOUR_M) * stronger, axis=1)
        ghost = ((near < k.GHOST_REACH_M) & (gamma[:, None] < 10.0**-2.5 * gamma[None, :])).any(axis=1)
        out.append(Relations(rows, apart[..., 0], apart[..., 1], disturbing * gamma[None, :], leftover, ghost))
    return out


def captured(apart: Floats, geometry: Floats, waveform: Waveform) -> Floats:
    """Return the share of a path's energy in the tangent space of another, for all pairs (n, n)."""
    scales = bound_scales(waveform)
    cosine = np.cos(0.5 * (geometry[:, None, 2] + geometry[None, :, 2])) ** AZIMUTH_EXPONENT
    s = (
        (apart[..., 0] / scales.distance_m) ** 2
        + (apart[..., 1] * cosine / scales.azimuth_rad) ** 2
        + (apart[..., 2] / scales.elevation_rad) ** 2
    )
    return np.asarray(np.exp(-s) * (1.0 + s), np.float64)


def chances(
    sample: Sample, parts: list[Relations], ratio_db: float, detection: tuple[float, float], threshold: float, law: Law
) -> Floats:
    """Return the detection probability (P,) of each path of a sample; `detection` is (dof, gain)."""
    table = ncx2.sf(2.0 * threshold, detection[0], detection[1] * 10.0 ** (_TABLE_DB / 10.0))
    out = np.zeros(len(sample.link))
    for p in parts:
        fall = 10.0**law.log_sidelobes / (1.0 + (p.behind / law.sidelobe_m) ** 2)
        diffuse = (p.behind >= 0.0) & (p.behind <= k.DIFFUSE_TO_M)
        fall = fall + np.where(diffuse, np.exp(-np.maximum(p.behind, 0.0) / k.TRAIL_DECAY_M), 0.0)
        toward = 10.0**law.log_trail * np.exp(-0.5 * (p.beside / k.TRAIL_BESIDE_RAD) ** 2) + 10.0**law.log_around
        disturbance = 1.0 + 10.0 ** (-ratio_db / 10.0) * np.sum(p.disturbing * fall * toward, axis=1)
        gamma_db = sample.gamma_db[p.rows] + 10.0 * np.log10(np.maximum(p.leftover, 1e-12) / disturbance)
        alone = np.interp(gamma_db, _TABLE_DB, table)
        crowded = 1.0 / (1.0 + np.exp(-np.clip((gamma_db - law.centre_db) / law.width_db, -50.0, 50.0)))
        isolated = (p.leftover > k.ISOLATED_LEFTOVER) & (disturbance < k.DISTURBED)
        out[p.rows] = np.where(isolated, alone, crowded) * ~p.ghost
    return out
