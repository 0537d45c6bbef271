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
from cellslam.slam.ekf_slam.start.fusion_kernel import root_of

Gaussian = tuple[Floats, Floats]


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
