"""Compiled: maps copied at resampling, and read out for an estimate."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from cellslam.slam.fastslam.layout import BIAS0, GAIN, HITS, IDENTITY, OFFSET0, SCALE0, SIGMA
from cellslam.slam.fastslam.predict_kernel import position_into


@njit(cache=True, parallel=True)
def copy_maps(records, counts, source, target):
    """Copy the live records of each source particle over those of its target."""
    for k in prange(len(source)):
        a, b = source[k], target[k]
        for link in range(counts.shape[1]):
            live = counts[a, link]
            counts[b, link] = live
            records[b, link, :live, :] = records[a, link, :live, :]


@njit(cache=True, parallel=True)
def gather_maps(records, counts, ancestors, out):
    """Copy the live records of each ancestor into a new array."""
    for k in prange(len(ancestors)):
        for link in range(counts.shape[1]):
            live = counts[k, link]
            out[k, link, :live, :] = records[ancestors[k], link, :live, :]


@njit(cache=True)
def map_into(records, counts, theta, cov, site_of, hits, out_id, out_link, position, covariance):
    """Write confirmed VTs of one particle: x = x(mu), cov = J (Sigma + G P G^T) J^T; return their number."""
    n = 0
    sites = theta.shape[0] - 2
    jacobian = np.empty((3, 3))
    inner = np.empty((3, 3))
    gain = np.empty((3, 3))
    block = np.empty((3, 3))
    for link in range(counts.shape[0]):
        index = (site_of[link], sites, sites + 1)
        for r in range(3):
            for c in range(3):
                block[r, c] = cov[index[r], index[c]]
        for j in range(counts[link]):
            vt = records[link, j]
            if vt[HITS] < hits:
                continue
            db, dg, ds = (
                theta[index[0]] - vt[OFFSET0],
                theta[sites] - vt[BIAS0],
                theta[sites + 1] - vt[SCALE0],
            )
            position_into(position[n], jacobian, vt, db, dg, ds)
            for r in range(3):
                for c in range(3):
                    gain[r, c] = vt[GAIN + 3 * r + c]
            inner[:, :] = gain @ block @ gain.T
            k = 0
            for r in range(3):
                for c in range(r, 3):
                    inner[r, c] += vt[SIGMA + k]
                    if c > r:
                        inner[c, r] += vt[SIGMA + k]
                    k += 1
            covariance[n] = jacobian @ inner @ jacobian.T
            out_id[n], out_link[n] = int(vt[IDENTITY]), link
            n += 1
    return n
