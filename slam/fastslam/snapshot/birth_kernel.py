"""Compiled: VTs born from one measurement each."""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.clock import begin_clock
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.snapshot.measurement_kernel import LEAST_RANGE_M, MOST_RANGE_M, evenly
from cellslam.slam.fastslam.state.lanes_kernel import columns_at, mat_at, put, vec_at
from cellslam.slam.fastslam.state.layout import (
    ANCHOR,
    GAIN,
    HITS,
    LANES,
    MU,
    SIGMA,
    THETA0,
    W_B,
    W_G,
    W_GUESS,
    W_POSE,
    W_ROT,
    W_THETA,
    Rows,
)
from cellslam.slam.fastslam.state.spherical_vt_kernel import begin, begin_gain, begin_spread
from cellslam.slam.model.matrices_kernel import Vec3, mat_vec

B = LANES


@njit(cache=True, error_model="numpy")
def complete(w: Rows, z: Rows, particle: int, birth: int) -> None:
    """Write what each lane takes for the distance, cos and sin of the azimuth, and variance of the range of a birth
    from measurement z: what was measured, or for a missing component a guess of its own.

    particle: number of the first lane's; birth: number of the measurement.
    """
    F = w.dtype.type
    for l in range(B):
        put(w, W_GUESS, l, (z[0], z[1], z[2], z[5]))
    if z[8] == 0.0:
        for l in range(B):
            share = evenly(particle + l, birth, 1)
            rho = F(LEAST_RANGE_M * (MOST_RANGE_M / LEAST_RANGE_M) ** share)
            w[W_GUESS * B + l] = w[W_B * B + l] + rho
            w[(W_GUESS + 3) * B + l] = z[5] * rho * rho
    if z[9] == 0.0:
        for l in range(B):
            azimuth = 2.0 * math.pi * evenly(particle + l, birth, 0)
            w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l] = math.cos(azimuth), math.sin(azimuth)


@njit(error_model="numpy")
def give_birth(parts: Parts, w: Rows, rec: Rows, z: Rows) -> None:
    """Write the record of a VT born from measurement z in every lane (docs/explanation/fastslam.md, step 6).

    z is as in `innovate`, completed by `complete`.

    Given theta the birth is exact: range variance q_d, G = (-1, 0, 0) for the offset (0 where no distance was
    measured); what the pose owes to bias and scale is passed on to the VT.
    """
    F = w.dtype.type
    ce, se = z[3], z[4]
    for l in range(B):
        ca, sa = w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l]
        rotation, anchor = mat_at(w, W_ROT, l), vec_at(w, W_POSE, l)
        rho = max(w[W_GUESS * B + l] - w[W_B * B + l], F(1e-3))
        # direction in the world frame, and its derivatives by the measured angles
        n = mat_vec(rotation, Vec3(ce * ca, ce * sa, se))
        by_azimuth = mat_vec(rotation, Vec3(-(ce * sa), ce * ca, F(0.0)))
        by_elevation = mat_vec(rotation, Vec3(-se * ca, -se * sa, ce))
        q = Vec3(w[(W_GUESS + 3) * B + l], z[6], z[7])
        pose_by_bias, pose_by_scale = columns_at(w, W_G, l)
        put(rec, ANCHOR, l, anchor)
        put(rec, MU, l, begin(F, rho, n))
        put(rec, SIGMA, l, begin_spread(F, n, by_azimuth, by_elevation, q))
        put(rec, GAIN, l, begin_gain(F, rho, n, z[8], pose_by_bias, pose_by_scale))
        put(rec, THETA0, l, vec_at(w, W_THETA, l))
        rec[HITS * B + l] = F(1.0)
    begin_clock(parts.clock, w, rec)
