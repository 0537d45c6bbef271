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

from collections.abc import Iterator
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

LANES = 32
Rows = NDArray[Any]  # rows of LANES numbers, flat
Five = tuple[Any, Any, Any, Any, Any]


class Layout:
    """Fields, name and number of rows each, that follow one another from row `first` on.

    Iterating gives the first row of each field, and the row after the last.
    """

    def __init__(self, first: int = 0, **sizes: int) -> None:
        self.first, self.sizes = first, sizes

    def __iter__(self) -> Iterator[int]:
        return accumulate(self.sizes.values(), initial=self.first)


# A track's record: rows of LANES. MU: range, cosine and sine of azimuth and of elevation; SIGMA: 00 01 02 11 12 22;
# GAIN: G, row by row; THETA0: offset, bias and scale.
RECORD_LAYOUT = Layout(ANCHOR=3, MU=5, SIGMA=6, GAIN=9, THETA0=3, HITS=1)
ANCHOR, MU, SIGMA, GAIN, THETA0, HITS, RECORD = RECORD_LAYOUT
# Where clocks drift, a record goes on (see `clock`):
RATE_LAYOUT = Layout(RECORD, RATE_GAIN=3, RATE0=1, TIME0=1)
RATE_GAIN, RATE0, TIME0, RECORD_WITH_RATE = RATE_LAYOUT

# What a track could show when last predicted, rows over the tracks of a map: least and greatest distance, how far the
# particles had moved, azimuth in the world frame, give or take, how far they had turned, least distance from a
# particle, greatest variances of distance and of azimuth.
LOW, HIGH, MOVED, CENTRE, WIDTH, TURNED, NEAR, LONG, BROAD = range(9)
BOUND = 9

# A block's state: rows of LANES; K nuisances follow, then their covariance (K x K). POSE_G: d(x, y, psi)/d(bias,
# scale), row by row; BIAS, SCALE: sampled errors of each odometry component.
STATE_LAYOUT = Layout(POSE=6, POSE_G=6, BIAS=6, SCALE=6)
POSE, POSE_G, BIAS, SCALE, THETA = STATE_LAYOUT

# A track's prediction: rows of LANES.
OUT_LAYOUT = Layout(
    O_H=9, O_A=9, O_S=6, O_C=6,  # dh/ds, dh/dtheta over all paths, H Sigma H^T, A P A^T
    O_X=1, O_Y=1, O_Z=1, O_FLAT=1, O_FULL=1,  # VT in the body frame
    O_MU=5,  # mu at the present theta
    O_SCORE=1,  # log of visible and detected against missed, less log clutter density
    O_AR=3,  # dh/d(rate) over all paths, where clocks drift
)  # fmt: skip
O_H, O_A, O_S, O_C, O_X, O_Y, O_Z, O_FLAT, O_FULL, O_MU, O_SCORE, O_AR, OUT = OUT_LAYOUT

# Scratch W: rows of LANES.
W_LAYOUT = Layout(
    W_POSE=6, W_G=6, W_ROT=9,  # pose, its sensitivity as POSE_G, rotation
    W_THETA=3, W_P=6,  # mean of offset, bias and scale, and its covariance, for this site
    W_E=3, W_D2=1, W_DET=1, W_SCORE=1, W_MASK=1, W_INV=6,  # one pair: e, e^T S^-1 e, det S, S^-1
    W_LOG=1, W_EXPONENT=1,  # its log det S
    W_REACH=4,  # expected distance and its variance, azimuth against the first lane and its variance
    W_Y=3, W_INFO=6,  # y and I of the link at hand, over (offset, bias, scale)
    W_RATE=1, W_PR=4,  # where clocks drift: mean of the rate, its covariances with itself, offset, bias and scale
    W_SITE=1,  # number of the site, in the first lane
)  # fmt: skip
(
    W_POSE, W_G, W_ROT, W_THETA, W_P, W_E, W_D2, W_DET, W_SCORE, W_MASK, W_INV, W_LOG, W_EXPONENT,
    W_REACH, W_Y, W_INFO, W_RATE, W_PR, W_SITE, W_ROWS,
) = W_LAYOUT  # fmt: skip
W_B = W_THETA  # the offset alone
# At births the rows of a pair hold what a lane takes for distance, cos and sin of azimuth, and variance of range:
GUESS_LAYOUT = Layout(W_E, W_GUESS=4)
W_GUESS, _ = GUESS_LAYOUT


class Sums(NamedTuple):
    """First rows of what scratch V holds, in double precision: the log-weight, what is summed up over a snapshot,
    y = A^T S^-1 e and I = A^T S^-1 A, then room for the update of theta: P, its factor L, I L, X, the mean's change."""

    weight: int
    y: int
    info: int
    cov: int
    lower: int
    product: int
    root: int
    change: int
    rows: int


@register_jitable
def sums_of(nuisances: int) -> Sums:
    """Return the layout of V for K nuisances."""
    square = nuisances * nuisances
    info = V_Y + nuisances
    cov = info + square
    lower, product, root, change = cov + square, cov + 2 * square, cov + 3 * square, cov + 4 * square
    return Sums(V_WEIGHT, V_Y, info, cov, lower, product, root, change, change + nuisances)


V_WEIGHT, V_Y = 0, 1


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


class Step(NamedTuple):
    """What all blocks go by in one snapshot: its number, the interval before it, velocity (G, 6, LANES) in that, what
    was measured, and rules."""

    now: int
    dt: float
    velocity: np.ndarray
    measured: Measured
    rules: Rules


class Blocks(NamedTuple):
    """What is held of all particles: state (G, F LANES), maps, travelled (G, K - 1), log_weight (G, LANES): see
    `particles.Particles`."""

    state: np.ndarray
    tracks: Tracks
    travelled: np.ndarray
    log_weight: np.ndarray


class Link(NamedTuple):
    """One map of one block: status (C, LANES), alike (C,), records (C, RECORD LANES), ident, order (C,), bounds
    (BOUND, C)."""

    status: np.ndarray
    alike: np.ndarray
    records: np.ndarray
    ident: np.ndarray
    order: np.ndarray
    bounds: np.ndarray


class Scene(NamedTuple):
    """One link as one block sees it in a snapshot: numbers of its first measurement and of the next link's, share of
    its evidence that counts; how far the block's particles have travelled and turned, the middle of their yaw, and how
    far they lie from it."""

    first: int
    last: int
    share: float
    travelled: float
    turned: float
    psi: float
    psi_spread: float


class Bound(NamedTuple):
    """One track's column of `bounds`."""

    low: float
    high: float
    moved: float
    centre: float
    width: float
    turned: float
    near: float
    long: float
    broad: float


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
