"""Detection probability of each path of a sample as the statistical front end computes it, in NumPy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.stats import ncx2

from cellslam.benchmarks.calibration_scenes import Sample
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte import detector_model as k
from cellslam.sim.lte.bound import AZIMUTH_EXPONENT, bound_scales
from cellslam.sim.recording import Floats

_TABLE_DB = np.arange(-20.0, 70.0, 0.1)


@lru_cache(maxsize=4)
def relations(key: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return per path of a kept sample: leftover, 1 if a ghost by the rule, and the sums of stronger paths' SNR whose
    diffuse energy arrives there, from the path's own direction and from anywhere.
    """
    sample = _kept[key]
    leftover, ghost, trail, around = (np.full(len(sample.link), x) for x in (1.0, 0.0, 0.0, 0.0))
    for link in np.unique(sample.link):
        rows = np.flatnonzero(sample.link == link)
        geometry, gamma = sample.geometry[rows], 10.0 ** (sample.gamma_db[rows] / 10.0)
        apart = geometry[:, None] - geometry[None]
        apart[..., 1] = wrap_angle(apart[..., 1])
        stronger = gamma[None, :] > gamma[:, None]
        share = captured(apart, geometry) * (np.abs(apart[..., 0]) < k.NEIGHBOUR_M) * stronger
        leftover[rows] = np.prod(1.0 - share, axis=1)
        near = np.abs(apart[..., 0]) < k.GHOST_REACH_M
        ghost[rows] = (near & (gamma[:, None] < 10.0**-2.5 * gamma[None, :])).any(axis=1)
        inside = stronger & (apart[..., 0] >= k.TRAIL_FROM_M) & (apart[..., 0] <= k.TRAIL_TO_M)
        fall = np.where(inside, np.exp(-apart[..., 0] / k.TRAIL_DECAY_M) * gamma[None, :], 0.0)
        trail[rows] = np.sum(fall * np.exp(-0.5 * (apart[..., 1] / k.TRAIL_BESIDE_RAD) ** 2), axis=1)
        around[rows] = np.sum(fall, axis=1)
    return leftover, ghost, trail, around


def captured(apart: Floats, geometry: Floats) -> Floats:
    """Return the share of a path's energy in the tangent space of another, for all pairs (n, n)."""
    scales = bound_scales(100)
    cosine = np.cos(0.5 * (geometry[:, None, 2] + geometry[None, :, 2])) ** AZIMUTH_EXPONENT
    s = (
        (apart[..., 0] / scales.distance_m) ** 2
        + (apart[..., 1] * cosine / scales.azimuth_rad) ** 2
        + (apart[..., 2] / scales.elevation_rad) ** 2
    )
    return np.asarray(np.exp(-s) * (1.0 + s), np.float64)


_kept: dict[int, Sample] = {}


def chances(
    sample: Sample, ratio_db: float, detection: tuple[float, float], threshold: float, centre_db: float,
    width_db: float, log_trail: float, log_around: float,
) -> Floats:  # fmt: skip
    """Return the detection probability (P,) of each path of a sample; `detection` is (dof, gain)."""
    key = id(sample)
    _kept[key] = sample
    leftover, ghost, trail, around = relations(key)
    disturbance = 1.0 + 10.0 ** (-ratio_db / 10.0) * (10.0**log_trail * trail + 10.0**log_around * around)
    gamma_db = sample.gamma_db + 10.0 * np.log10(np.maximum(leftover, 1e-12) / disturbance)
    table = ncx2.sf(2.0 * threshold, detection[0], detection[1] * 10.0 ** (_TABLE_DB / 10.0))
    alone = np.interp(gamma_db, _TABLE_DB, table)
    overlapped = 1.0 / (1.0 + np.exp(-np.clip((gamma_db - centre_db) / width_db, -50.0, 50.0)))
    chance = np.where(leftover > k.ISOLATED_LEFTOVER, alone, overlapped)
    return np.asarray(chance * (ghost == 0.0), np.float64)
