"""Compiled: steps of clocks, found by what all looks of a site are off by together.

A small step leaves its mark in a block's innovations: of a unit step at the block's begin, `left` of a state's error is
still to be corrected after some updates, and H left is what the next innovation shows of it. The ratio of likelihoods
with and without a step, times the probability of a step in a block, decides. If there is none, the expected ratio is
one, so that by Markov's inequality the probability of a false alarm is no greater than that probability.

A large step takes all looks out of the gates: then looks that no VT explains, though all would be explained by one
shift of the distances, are evidence in the same way.

Source: Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", IEEE Trans. Automatic Control 21(1), 1976.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.slam.ekf_slam.snapshot.association_kernel import Pairs, associate, difference, expect
from cellslam.slam.ekf_slam.snapshot.sight_kernel import Sight, rotations_of
from cellslam.slam.ekf_slam.snapshot.update_kernel import Steps, innovate
from cellslam.slam.ekf_slam.state.layout import HITS, LINK, ArrayErrors, Filter, Measured, Rules

AGREE = 2  # looks that a shift must explain, and that nothing else does


class Shift(NamedTuple):
    """What the looks of a site are worth if distances are shifted: `score`, log-likelihood ratio to clutter, and how
    many are `paired`."""

    score: float
    paired: int


@lean(cache=True)
def expect_steps(f: Filter, steps: Steps) -> None:
    """Begin a block: nothing of a unit step of a clock is corrected. A clock that is known does not step."""
    steps.left[:] = 0.0
    steps.score[:], steps.information[:] = 0.0, 0.0
    for site in range(len(f.core.rate)):
        offset = f.core.first_offset + site
        if f.p[offset, offset] > 0.0:
            steps.left[site, offset] = 1.0


@lean(cache=True)
def take_steps(f: Filter, rules: Rules, steps: Steps) -> float:
    """End a block: correct the state by the steps that are likelier than none, as if the offset's variance had been
    open before it; return what that adds to the log-likelihood."""
    total, n = 0.0, f.size[0]
    for site in range(len(f.core.rate)):
        information = steps.information[site] + 1.0 / rules.step_m**2
        size, variance = steps.score[site] / information, 1.0 / information
        gain = rules.step + 0.5 * (size * steps.score[site] + math.log(variance / rules.step_m**2))
        if gain > 0.0:
            left = steps.left[site]
            for i in range(n):
                f.x[i] += left[i] * size
                for j in range(n):
                    f.p[i, j] += left[i] * variance * left[j]
            total += gain
    return total


@lean(cache=True)
def shift_clocks(f: Filter, a: ArrayErrors, seen: Measured, s: Sight, w: Pairs) -> None:
    """Shift the clock of each site whose looks, which nothing explains, one shift of their distances explains."""
    for site in range(len(f.core.rate)):
        offset = f.core.first_offset + site
        if f.p[offset, offset] > 0.0 and seen.rules.step > -math.inf and _unexplained(f, a, seen, site, s, w) >= AGREE:
            size, variance = _likely_shift(f, a, seen, site, s, w)
            f.x[offset] += size
            f.p[offset, offset] += variance


@lean(cache=True)
def _unexplained(f: Filter, a: ArrayErrors, seen: Measured, site: int, s: Sight, w: Pairs) -> int:
    """Return how many looks of a site with a distance have no VT in whose gate they are."""
    count = 0
    for link in range(len(seen.first) - 1):
        if seen.site_of[link] == site and f.links[link] == 1 and seen.first[link + 1] > seen.first[link]:
            associate(f, a, seen, link, s, w)
            for k in range(seen.first[link], seen.first[link + 1]):
                count += 1 if w.gated[k - seen.first[link]] == 0 and not math.isnan(seen.z[k, 0]) else 0
    return count


@lean(cache=True)
def _worth(f: Filter, a: ArrayErrors, seen: Measured, site: int, shift: float, s: Sight, w: Pairs) -> Shift:
    """Return what the looks of a site are worth with a shift of its clock, in m."""
    offset, score, paired = f.core.first_offset + site, 0.0, 0
    before = f.x[offset]
    f.x[offset] += shift
    for link in range(len(seen.first) - 1):
        if seen.site_of[link] == site and f.links[link] == 1 and seen.first[link + 1] > seen.first[link]:
            associate(f, a, seen, link, s, w)
            for k in range(seen.first[link + 1] - seen.first[link]):
                if w.row_of[k] >= 0:
                    score += w.score[w.row_of[k], k]
                    paired += 1
    f.x[offset] = before
    return Shift(score, paired)


@lean(cache=True)
def _likely_shift(f: Filter, a: ArrayErrors, seen: Measured, site: int, s: Sight, w: Pairs) -> tuple[float, float]:
    """Return the shift of a site's distances (m) that its looks agree on, and its variance (m^2); zeros: none."""
    none, rules, offset = _worth(f, a, seen, site, 0.0, s, w), seen.rules, f.core.first_offset + site
    turned, best, size, variance = rotations_of(f), 0.0, 0.0, 0.0
    for j in range(f.count[0]):
        link = f.slots[j, LINK]
        if seen.site_of[link] != site or f.links[link] == 0 or f.slots[j, HITS] < rules.confirm:
            continue
        expected = expect(f, a, j, offset, turned, s)
        for k in range(seen.first[link], seen.first[link + 1]):
            i = innovate(difference(seen.z[k], expected.z), seen.single[k], expected.hph)
            apart = i.e.y * i.e.y / i.s.yy + i.e.z * i.e.z / i.s.zz
            if math.isnan(seen.z[k, 0]) or apart > rules.gate or i.e.x * i.e.x <= rules.gate * i.s.xx:
                continue
            there = _worth(f, a, seen, site, i.e.x, s, w)
            prior = rules.step + 0.5 * (math.log(i.s.xx / rules.step_m**2) - (i.e.x / rules.step_m) ** 2)
            gain = there.score - none.score + prior
            if gain > best and there.paired >= none.paired + AGREE:
                best, size, variance = gain, i.e.x, i.s.xx
    return size, variance
