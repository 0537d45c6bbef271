"""What the filter whose covariance the bound is would meet on this drive: the errors that were really drawn.

The filter is linear about the truth: its states are deviations from the truth, of errors that persist the errors
themselves, which it takes for zero at first. Its mean passes through the recursion as one more column of the covariance
(`recursion_kernel`). How large its errors are, against the covariance, says whether the bound is right.

Source: the extended Kalman filter with its Jacobians at the truth, as in Taylor, "The Cramer-Rao estimation error lower
bound computation for deterministic nonlinear systems", IEEE Trans. Automatic Control 24(2), 1979.
"""

from __future__ import annotations

import numpy as np

from cellslam.benchmarks.bound.bound_model import Core
from cellslam.sim.frames import held, integrate_pose, wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording, Truth


def jumps(recording: Recording, truth: Truth, core: Core, step: Floats) -> Floats:
    """Return what each snapshot adds to the error (T, core), estimate less truth, of the shared states; in their units.

    Row 0 is the error of the priors. After it the odometry's errors move the pose, and the biases' walks add up, over
    the transition `step` (T, 6, core).
    """
    out = np.zeros((len(recording.time_s), core.size))
    out[0, :6] = recording.start_pose - truth.poses[0]
    out[0, 3:6] = wrap_angle(out[0, 3:6])
    out[0, core.bias[core.bias >= 0]] = -truth.odometry_bias[0, core.bias >= 0]
    out[0, core.scale[core.scale >= 0]] = -truth.odometry_scale[core.scale >= 0]
    out[0, core.offsets] = recording.sites.clock_offset_mean_m - truth.clock_offsets_m
    if len(out) < 2:
        return out
    velocity = (held(recording.odometry)[1:] - truth.odometry_bias[1:]) / (1.0 + truth.odometry_scale)
    out[1:, :6] = integrate_pose(truth.poses[:-1], velocity, np.diff(recording.time_s)) - truth.poses[1:]
    out[1:, 3:6] = wrap_angle(out[1:, 3:6])
    out[1:, core.bias[core.bias >= 0]] = -np.diff(truth.odometry_bias, axis=0)[:, core.bias >= 0]
    out[1:, :6] += np.einsum("tac,tc->ta", step[1:, :, 6:], out[1:, 6:])
    return out


def residuals(recording: Recording, truth: Truth, rows: Ints, predicted: Floats) -> Floats:
    """Return what measurements `rows` (n,) are off, distance, azimuth and elevation (n, 3) in m and rad.

    `predicted` (n, 3): of the true VTs from the true poses. What was not measured is zero. Clock offsets are taken as
    at the first snapshot: what clocks do after it is left in, for the filter to follow.
    """
    m = recording.measurements
    off = np.stack([m.distance_m[rows], m.azimuth_rad[rows], m.elevation_rad[rows]], axis=1) - predicted
    off[:, 0] -= truth.clock_offsets_m[recording.links.site[m.link[rows]]]
    off[:, 1:] = wrap_angle(off[:, 1:])
    return np.nan_to_num(off)
