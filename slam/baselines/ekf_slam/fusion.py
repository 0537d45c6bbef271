"""From one filter a site to one joint filter: their Gaussians multiplied, what they share counted once.

During the start each site has filters of its own over pose, odometry errors, its offset and its VTs. Given the shared
states c (pose and odometry errors) the maps of different sites are independent, so with the odometry's own belief p0

    p(c, maps | all)  is proportional to  p0(c) * product over sites of p(c, map_s | z_s) / p0(c).

This takes what a site has said about c to be about the present c; the noise that has entered since makes that an
approximation, as good as the odometry.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellslam.sim.recording import Floats

LEAST_SHARE = 1e-14  # of the largest variance, below which there is none left but rounding
SMALLEST = 1e-10  # share of the largest scaled variance below which a direction counts as known

Gaussian = tuple[Floats, Floats]


def root_of(cov: Floats) -> tuple[Floats, Floats]:
    """Return L (n, r) with cov = L L^T, in the directions that are uncertain, and its left inverse (r, n)."""
    scale = np.sqrt(np.maximum(np.diag(cov), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, basis = np.linalg.eigh(cov / np.outer(safe, safe))
    kept = values > SMALLEST * max(float(values[-1]), SMALLEST)
    spread = np.sqrt(values[kept])
    return scale[:, None] * basis[:, kept] * spread, (basis[:, kept] / spread).T / safe


def fuse(prior: Gaussian, sites: Sequence[Gaussian]) -> Gaussian:
    """Return the product of the odometry's belief and what each site adds to it; negative information is cut off."""
    mean, cov = prior
    root, left = root_of(cov)
    matrix, vector = np.eye(root.shape[1]), np.zeros(root.shape[1])
    for site_mean, site_cov in sites:
        values, axes = np.linalg.eigh(left @ site_cov @ left.T)
        told = (values < 1.0) & (values > LEAST_SHARE * values.max(initial=0.0))
        information, axes = 1.0 / values[told], axes[:, told]
        matrix += (axes * (information - 1.0)) @ axes.T
        vector += axes @ (information * (axes.T @ (left @ (site_mean - mean))))
    spread = root @ np.linalg.inv(matrix) @ root.T
    return mean + root @ np.linalg.solve(matrix, vector), 0.5 * (spread + spread.T)


def join(shared: Gaussian, parts: Sequence[Gaussian]) -> Gaussian:
    """Return the joint Gaussian over [c, map_1, map_2, ...], given the fused belief on c and each site's over [c, map].

    Keeps each site's p(map | c), and puts the fused belief in the place of its own belief on c.
    """
    mean_c, cov_c = shared
    n, sizes = len(mean_c), [len(part[0]) - len(mean_c) for part in parts]
    total = n + sum(sizes)
    mean, slope, own = np.zeros(total), np.zeros((total, n)), np.zeros((total, total))
    mean[:n], slope[:n] = mean_c, np.eye(n)
    start = n
    for (site_mean, site_cov), size in zip(parts, sizes, strict=True):
        root, left = root_of(site_cov[:n, :n])
        whitened = left @ site_cov[:n, n:]
        gain = np.linalg.lstsq(left @ root, whitened, rcond=None)[0].T @ left
        rows = slice(start, start + size)
        mean[rows] = site_mean[n:] + gain @ (mean_c - site_mean[:n])
        slope[rows] = gain
        own[rows, rows] = site_cov[n:, n:] - gain @ site_cov[:n, n:]
        start += size
    cov = slope @ cov_c @ slope.T + own
    return mean, 0.5 * (cov + cov.T)
