"""The array's calibration in a mixture of joint filters: what they have found, and what they begin with.

A weight's state is in deviations of its field; a calibration is in m and rad, so that it means the same to filters that
assume other sizes. What an earlier drive found holds as it is; where it met nothing the prior is that of this filter.

Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990 (states that stay).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.state.layout import ArrayErrors
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.pose_moments import mixture_moments


def found(mixture: Mixture, errors: ArrayErrors) -> Calibration:
    """Return the calibration as all filters of a mixture have it, by their weights: mean and covariance of the mixture.

    A filter that has not met a weight has its prior.
    """
    owners, component, size = _owners(errors)
    k, states = len(mixture), mixture.arrays.fields.state[: len(mixture), : len(owners)]
    met = np.flatnonzero((states >= 0).any(axis=0))
    x, p = np.zeros((k, len(met))), np.tile(np.eye(len(met)), (k, 1, 1))
    for i in range(k):
        there = np.flatnonzero(states[i, met] >= 0)
        index = states[i, met[there]]
        x[i, there] = mixture.arrays.x[i, index]
        p[i][np.ix_(there, there)] = mixture.arrays.p[i][np.ix_(index, index)]
    mean, covariance = mixture_moments(mixture.weights(), x, p)
    std = size[component[met]]
    g = errors.calibration_grid
    return Calibration(
        size, g.scale, g.step / g.scale, math.sqrt(g.reach2) / g.scale, component[met], owners[met] % g.cells,
        std * mean, 0.5 * (covariance + covariance.T) * std[:, None] * std,
    )  # fmt: skip


def begin_with(mixture: Mixture, errors: ArrayErrors, known: Calibration) -> None:
    """Let the weights of a calibration enter all filters of a new mixture, as they are known."""
    size = errors.calibration
    first = np.concatenate([[0], np.cumsum(size > 0.0)])[known.component] * errors.calibration_grid.cells
    owner, std, count = first + known.cell, size[known.component], len(known.mean)
    mixture.reserve(count, 0)
    f, at = mixture.arrays, int(mixture.arrays.size[0, 0]) + np.arange(count)
    f.x[:, at] = known.mean / std
    f.p[:, at[:, None], at] = known.covariance / (std[:, None] * std)
    f.owner[:, at], f.fields.state[:, owner] = owner, at
    f.size[:] += count


def check_fits(known: Calibration, size: Floats, scale_rad: float) -> None:
    """Raise InputError unless a filter with errors of these sizes (3,), m and rad, and this scale can begin with a
    calibration."""
    if not (size > 0.0).any() or scale_rad <= 0.0:
        raise InputError(
            "a calibration, but no calibration error as a state: give its sizes and scale, or leave it out"
        )
    if not math.isclose(known.scale_rad, scale_rad, rel_tol=1e-9):
        theirs, ours = np.degrees(known.scale_rad), np.degrees(scale_rad)
        raise InputError(
            f"a calibration over {theirs:g} deg, but the filter's is over {ours:g} deg: set calibration_scale_deg = "
            f"{theirs:g}, or calibrate again"
        )
    if ((known.size > 0.0) != (size > 0.0)).any():
        raise InputError(
            f"a calibration of {', '.join(known.components)}, but the filter has sizes {size.tolist()} (m, rad, rad) "
            "of distance, azimuth, elevation: set calibration_m, _azimuth_deg, _elevation_deg above 0 for those alone"
        )


def _owners(errors: ArrayErrors) -> tuple[Ints, Ints, Floats]:
    """Return the numbers (W,) of all weights of the calibration, their components (W,), and its sizes (3,)."""
    there, cells = np.flatnonzero(errors.calibration > 0.0), errors.calibration_grid.cells
    return np.arange(len(there) * cells), np.repeat(there, cells), np.array(errors.calibration)
