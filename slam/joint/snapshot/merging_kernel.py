"""Compiled: whether another path has merged with that of a VT.

What the array cannot resolve is measured as one path, somewhere between: azimuths of a VT err by some degrees from one
moment to the next, and for as long as that lasts. A single measurement does not tell, a jump does. So each VT has a
probability that another path has merged with its own, that of a hidden Markov chain with two modes, and its azimuths
count for less by it.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.6, for
modes that switch; that one update with the mean information of both modes will do is an approximation of our own.
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import lean
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.slam.joint.snapshot.sight_kernel import Sight, coordinates, geometry
from cellslam.slam.joint.state.layout import HITS, LINK, MERGED, SHARE, Block, Filter
from cellslam.slam.model.matrices_kernel import Sym3, Vec3
from cellslam.slam.model.measurement_kernel import Rotations, Spherical

END_RATE = 0.1  # merged paths part so often, 1/s
SHIFT2 = math.radians(2.5) ** 2  # variance of azimuth by merging
LASTS = 5.0  # for how many means of a block one such shift counts
BESIDE = 0.3  # probability where a VT that is not seen should be seen beside
UNRESOLVED = (9.2, 0.27, 0.28)  # so near, in m and rad: what an LTE front end with 20 MHz does not resolve


@lean
def expected_share(rate: float) -> float:
    """Return the probability that another path has merged with one of which nothing is known.

    rate: how often that begins, 1/s; 0: never.
    """
    return rate / (rate + END_RATE)


@lean
def expect_merging(f: Filter, rate: float, dt: float) -> None:
    """Let paths merge and part for a time dt (s)."""
    share, left = expected_share(rate), math.exp(-(rate + END_RATE) * dt)
    for j in range(f.count[0]):
        f.anchor[j, MERGED] = share + left * (f.anchor[j, MERGED] - share)


@lean
def expect_beside(
    f: Filter, b: Block, j: int, offset: int, seen: Spherical, place: Vec3, turned: Rotations, confirm: int, s: Sight
) -> None:
    """Expect that another path has merged with that of VT j, seen there (m and rad) in this block, where a confirmed VT
    that is not seen has its place within what is resolved."""
    for i in range(f.count[0]):
        sought = f.slots[i, LINK] == f.slots[j, LINK] and f.slots[i, HITS] >= confirm and f.anchor[i, SHARE] == 1.0
        if i == j or b.detections[i] > 0 or not sought:
            continue
        other = geometry(f, i, offset, place, turned, coordinates(f, i), s)
        if (
            abs(other.distance - seen.distance) < UNRESOLVED[0]
            and abs(wrap(other.azimuth - seen.azimuth)) < UNRESOLVED[1]
            and abs(other.elevation - seen.elevation) < UNRESOLVED[2]
        ):
            f.anchor[j, MERGED] = max(f.anchor[j, MERGED], BESIDE)


@lean
def allow_for_merging(f: Filter, j: int, e: float, s: Sym3, q: float) -> tuple[Sym3, float]:
    """Judge by the innovation e (rad) of its azimuth whether another path has merged with that of VT j.

    s: covariance of the innovation, in m and rad, of which q (rad^2) is the measurement's. Return the covariance that
    the azimuth counts with, and by what the log-density of such a measurement, merged or not, is greater than by that
    covariance.
    """
    before, wide, e2 = f.anchor[j, MERGED], s.yy + SHIFT2, e * e
    plain, merged = math.log(s.yy) + e2 / s.yy, math.log(wide) + e2 / wide
    least = min(plain, merged)
    log_sum = -0.5 * least + math.log(
        (1.0 - before) * math.exp(-0.5 * (plain - least)) + before * math.exp(-0.5 * (merged - least))
    )
    share = before * math.exp(-0.5 * merged - log_sum)
    f.anchor[j, MERGED] = share
    counted = s.yy - q + 1.0 / ((1.0 - share) / q + share / (q + LASTS * SHIFT2))
    lacks = log_sum + 0.5 * (math.log(counted) + e2 / counted)
    return Sym3(s.xx, s.xy, s.xz, counted, s.yz, s.zz), lacks
