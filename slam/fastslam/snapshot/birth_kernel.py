"""Compiled: VTs born from one measurement each."""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.parts.clock import begin_offset
from cellslam.slam.fastslam.parts.landmarks import begin, begin_gain, begin_spread
from cellslam.slam.fastslam.snapshot.measurement_kernel import LEAST_RANGE_M, MOST_RANGE_M, evenly
from cellslam.slam.fastslam.state.layout import (
    ANCHOR,
    BIAS0,
    GAIN,
    HITS,
    LANES,
    MU,
    OFFSET0,
    SCALE0,
    SIGMA,
    W_B,
    W_BIAS,
    W_G,
    W_GUESS,
    W_POSE,
    W_ROT,
    W_SCALE,
)

B = LANES


@njit(cache=True, error_model="numpy")
def complete(w, z, particle, birth):
    """Write what each lane takes for the distance, cos and sin of the azimuth, and variance of the range of a birth
    from measurement z: what was measured, or for a missing component a guess of its own.

    particle: number of the first lane's; birth: number of the measurement.
    """
    F = w.dtype.type
    for l in range(B):
        w[W_GUESS * B + l], w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l] = z[0], z[1], z[2]
        w[(W_GUESS + 3) * B + l] = z[5]
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
def give_birth(parts, w, rec, z):
    """Write the record of a VT born from measurement z in every lane (method.md: birth); z as in `innovate`, completed
    by `complete`.

    Given theta the birth is exact: range variance q_d, G = (-1, 0, 0) for the offset (0 where no distance was
    measured); what the pose owes to bias and scale is passed on to the VT.
    """
    F = w.dtype.type
    ce_b, se_b, q1, q2, measured = z[3], z[4], z[6], z[7], z[8]
    for l in range(B):
        cosine, sine = w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l]
        bx, by = ce_b * cosine, ce_b * sine
        ax, ay = -by, bx
        ex, ey = -se_b * cosine, -se_b * sine
        r0, r1, r2 = w[W_ROT * B + l], w[(W_ROT + 1) * B + l], w[(W_ROT + 2) * B + l]
        r3, r4, r5 = w[(W_ROT + 3) * B + l], w[(W_ROT + 4) * B + l], w[(W_ROT + 5) * B + l]
        r6, r7, r8 = w[(W_ROT + 6) * B + l], w[(W_ROT + 7) * B + l], w[(W_ROT + 8) * B + l]
        nx, ny, nz = r0 * bx + r1 * by + r2 * se_b, r3 * bx + r4 * by + r5 * se_b, r6 * bx + r7 * by + r8 * se_b
        rho = max(w[W_GUESS * B + l] - w[W_B * B + l], F(1e-3))
        rec[ANCHOR * B + l] = w[W_POSE * B + l]
        rec[(ANCHOR + 1) * B + l] = w[(W_POSE + 1) * B + l]
        rec[(ANCHOR + 2) * B + l] = w[(W_POSE + 2) * B + l]
        # world angles by body angles
        uax, uay, uaz = r0 * ax + r1 * ay, r3 * ax + r4 * ay, r6 * ax + r7 * ay
        uex, uey, uez = r0 * ex + r1 * ey + r2 * ce_b, r3 * ex + r4 * ey + r5 * ce_b, r6 * ex + r7 * ey + r8 * ce_b
        pxb, pxs, pyb = w[W_G * B + l], w[(W_G + 1) * B + l], w[(W_G + 2) * B + l]
        pys, ppb, pps = w[(W_G + 3) * B + l], w[(W_G + 4) * B + l], w[(W_G + 5) * B + l]
        anchor, n = (w[W_POSE * B + l], w[(W_POSE + 1) * B + l], w[(W_POSE + 2) * B + l]), (nx, ny, nz)
        m0, m1, m2, m3, m4 = begin(parts.landmarks, F, anchor, rho, n)
        rec[MU * B + l] = m0
        rec[(MU + 1) * B + l] = m1
        rec[(MU + 2) * B + l] = m2
        rec[(MU + 3) * B + l] = m3
        rec[(MU + 4) * B + l] = m4
        s0, s1, s2, s3, s4, s5 = begin_spread(
            parts.landmarks, F, rho, n, (uax, uay, uaz), (uex, uey, uez), w[(W_GUESS + 3) * B + l], q1, q2
        )
        rec[SIGMA * B + l] = s0
        rec[(SIGMA + 1) * B + l] = s1
        rec[(SIGMA + 2) * B + l] = s2
        rec[(SIGMA + 3) * B + l] = s3
        rec[(SIGMA + 4) * B + l] = s4
        rec[(SIGMA + 5) * B + l] = s5
        g0, g1, g2, g3, g4, g5, g6, g7, g8 = begin_gain(
            parts.landmarks, F, rho, n, measured, (pxb, pyb, ppb), (pxs, pys, pps)
        )
        rec[GAIN * B + l] = g0
        rec[(GAIN + 1) * B + l] = g1
        rec[(GAIN + 2) * B + l] = g2
        rec[(GAIN + 3) * B + l] = g3
        rec[(GAIN + 4) * B + l] = g4
        rec[(GAIN + 5) * B + l] = g5
        rec[(GAIN + 6) * B + l] = g6
        rec[(GAIN + 7) * B + l] = g7
        rec[(GAIN + 8) * B + l] = g8
        rec[OFFSET0 * B + l] = w[W_B * B + l]
        rec[BIAS0 * B + l] = w[W_BIAS * B + l]
        rec[SCALE0 * B + l] = w[W_SCALE * B + l]
        rec[HITS * B + l] = F(1.0)
    begin_offset(parts.clock, w, rec)
