"""Where each number lies in memory: everything is in rows of LANES particles, so that each operation is one vector
loop.

Particles are kept in blocks of LANES = 32. A block has, for each link, a list of tracks: a track is one VT as born
from one measurement, kept for all particles (lanes) of the block that believe in it. A track's record is RECORD rows:

    s = (range, azimuth, elevation) about a fixed anchor, the particle's position at the VT's birth, axes of the world
    frame;
    s | theta ~ N(mu + G (theta - theta0), Sigma),   theta = (clock offset of its site, yaw-rate bias, odometer scale)

with theta0 the nuisance mean at the last touch: a VT that is not seen is never written. The angles of mu are kept as
cosines and sines, which an update turns by its small correction: no trigonometric function is called in the steady
state.

The kernels work in few flat arrays at constant offsets. That is what lets the compiler prove that rows do not overlap,
and use the widest vectors of the machine. Records, predictions and W are in single precision, coordinates taken from
the start of the drive: a number is rounded to 0.1 mm and 1e-7 rad, and half as many bytes move. Poses, nuisances and
weights are in double precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

LANES = 32

# A track's record: rows of LANES.
ANCHOR, MU = 0, 3  # MU: 5 numbers, see `landmarks`
RANGE, CA, SA, CE, SE = 3, 4, 5, 6, 7  # of them, where a VT is kept in spherical coordinates
SIGMA = 8  # 6: 00 01 02 11 12 22
GAIN = 14  # 9: G, row by row
OFFSET0, BIAS0, SCALE0 = 23, 24, 25
HITS = 26
RECORD = 27
OWN_OFFSET, OWN_VARIANCE = 27, 28  # where each VT has a clock offset of its own, mean and variance of it
RECORD_WITH_OFFSET = 29
RATE_GAIN, RATE0, TIME0 = 27, 30, 31  # where clocks drift, see `drift`; RATE_GAIN: 3
RECORD_WITH_RATE = 32

# What a track could show when last predicted, rows over the tracks of a map: least and greatest distance, how far the
# particles had moved, azimuth in the world frame, give or take, how far they had turned, least distance from a
# particle, greatest variances of distance and of azimuth.
LOW, HIGH, MOVED, CENTRE, WIDTH, TURNED, NEAR, LONG, BROAD = range(9)
BOUND = 9

# A block's state: rows of LANES; K nuisances follow, then their covariance (K x K).
POSE, POSE_G = 0, 6  # POSE_G: d(x, y, psi)/d(bias, scale), row by row
BIAS, SCALE = 12, 18  # sampled errors of each odometry component
THETA = 24

# A track's prediction: rows of LANES.
O_H, O_A, O_S, O_C = 0, 9, 18, 24  # dh/ds, dh/dtheta over all paths, H Sigma H^T, A P A^T
O_X, O_Y, O_Z, O_FLAT, O_FULL = 30, 31, 32, 33, 34  # VT in the body frame
O_MU = 35  # 5: mu at the present theta
O_SCORE = 40  # log of visible and detected against missed, less log clutter density
O_OFFSET = 41  # clock offset that distances are expected with
O_AR = 42  # 3: dh/d(rate) over all paths, where clocks drift
OUT = 45

# Scratch W: rows of LANES.
W_POSE, W_G, W_ROT, W_DROT = 0, 6, 12, 21
W_B, W_BIAS, W_SCALE, W_P = 30, 31, 32, 33  # nuisance mean, and its covariance for this site (6)
W_E, W_D2, W_DET, W_SCORE, W_MASK, W_INV = 40, 43, 44, 45, 46, 47  # one pair; W_INV 6 rows
W_LOG, W_EXPONENT = 53, 54
W_GUESS = 40  # 4 rows, at births: distance, cos and sin of azimuth, variance of range
W_REACH = 55  # 4 rows: expected distance and its variance, azimuth against the first lane and its variance
W_LINK = 60  # 9 rows: y (3) and I (00 01 02 11 12 22) of the link at hand, over (offset, bias, scale)
W_OFFSET_PRIOR = 69  # variance of the site's offset, as it was loaded
W_RATE = 70  # where clocks drift: mean of the rate, and its covariances with itself, offset, bias and scale
W_PR = 71
W_SITE = 75  # number of the site, in the first lane
W_ROWS = 76

# Scratch V: rows of LANES, in double precision: what is summed up over a snapshot.
V_WEIGHT = 0
V_Y = 1  # K rows: A^T S^-1 e; then K x K rows: A^T S^-1 A, and scratch for the solve


def scratch_rows(nuisances: int) -> int:
    """Return the number of rows of V for K nuisances."""
    return V_Y + 2 * nuisances + 5 * nuisances * nuisances


class Rules(NamedTuple):
    """What the kernels take of the options: `tables` (2, 2, ages), logs of visible-and-detected and of missed for VTs
    seen once and others; ages at which to drop VTs seen once, and unconfirmed ones; whether to look for doubles."""

    log_clutter: float
    gate: float
    log_birth: float
    slack_m: float
    hits: float
    age_once: int
    age_twice: int
    exponent: float
    least_score: float
    merging: bool
    tables: np.ndarray


class Measured(NamedTuple):
    """A snapshot: `first` (L + 1,) measurement of each link; `site_of` (L,); `shares` (L,): weight of a link's evidence
    on which VTs there are; z, many, fresh (M, 15): see `measurement_kernel.pack`; `born`: number of the first row."""

    first: np.ndarray
    site_of: np.ndarray
    shares: np.ndarray
    z: np.ndarray
    many: np.ndarray
    fresh: np.ndarray
    born: int


class Tracks(NamedTuple):
    """The maps of all blocks: see `particles.Particles`."""

    status: np.ndarray
    alike: np.ndarray
    records: np.ndarray
    ident: np.ndarray
    order: np.ndarray
    counts: np.ndarray
    bounds: np.ndarray


class Link(NamedTuple):
    """One map of one block: status (C, LANES), alike (C,), records (C, RECORD LANES), ident, order (C,), bounds
    (BOUND, C)."""

    status: np.ndarray
    alike: np.ndarray
    records: np.ndarray
    ident: np.ndarray
    order: np.ndarray
    bounds: np.ndarray


class Scratch(NamedTuple):
    """What one thread works in: W, seen as integers too, and V; for C tracks and M measurements of a link near,
    reached (C,), rows (C, OUT LANES), scores (C, M, LANES), claims (C, M), row_of (M, LANES), table (C, M), column
    (M,), floats and ints for the assignment."""

    w: np.ndarray
    bits: np.ndarray
    v: np.ndarray
    near: np.ndarray
    reached: np.ndarray
    rows: np.ndarray
    scores: np.ndarray
    claims: np.ndarray
    row_of: np.ndarray
    table: np.ndarray
    column: np.ndarray
    floats: np.ndarray
    ints: np.ndarray
