"""Compiled: steps of clocks and slip of wheels, found by what measurements are off by together.

A small step leaves its mark in a block's innovations: of a unit step at the block's begin, `left` of a state's error is
still to be corrected after some updates, and H left is what the next innovation shows of it. The ratio of likelihoods
with and without a step, times the probability of a step in a block, decides. If there is none, the expected ratio is
one, so that by Markov's inequality the probability of a false alarm is no greater than that probability. Wheels that
slip put all sites off: what a shift of the vehicle along its path explains as well is no step.

Slip that lasts some seconds moves a vehicle by far more than the odometry's white noise, block after block. Along the
path and in heading its deviation is a share, SLIP, of the distance and turn that a block reports. As slip is common, no
decision is made: with the odds o of a slip, prior odds times the ratio of likelihoods, the state is the mixture of
both, by its two moments:

    q = o / (1 + o),   x <- x + q m l,   P <- P + q (v + (1 - q) m^2) l l^T,     m, v: size of the slip; l: what is left

A large step takes all measurements out of the gates. That one shift of the distances would explain what no confirmed VT
does is evidence in the same way, at once where several measurements agree, in a few snapshots where a site has but one.

Sources: Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", IEEE Trans. Automatic Control 21(1), 1976; Bar-Shalom, Li and Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 11.6, for the mixture that is made one Gaussian (generalized
pseudo-Bayesian estimator of first order).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.recording import Floats
from cellslam.slam.joint.snapshot.association_kernel import Pairs, associate, difference, expect
from cellslam.slam.joint.snapshot.observation_kernel import Jacobian, rotations_of
from cellslam.slam.joint.snapshot.update_kernel import Steps, innovate
from cellslam.slam.joint.state.layout import HITS, LAST, LINK, ArrayErrors, Block, Filter, Measured, Rules

AGREE = 2  # measurements whose agreement on a shift is evidence at once
ALONE = 3.0  # a lone measurement can give this part of the evidence needed in a snapshot, so that it takes several
SLIP_M = 1.0  # deviation of how far slipping wheels shift the vehicle in a block: what this explains is no step
SLIP = 0.3  # deviation of a slip along the path, and in heading, as a share of the block's distance and turn
NO_SLIP = 0.01  # probability below which a slip changes nothing
RECENT = 16  # snapshots after which a VT that was seen no more is not evidence alone: another may be in its direction


class Shift(NamedTuple):
    """A shift of a site's distances: `size` (m), its `variance` (m^2); by how much more likely measurements are with
    it, `gain`, and how many more are `paired`."""

    size: float
    variance: float
    gain: float
    paired: int


@lean
def expect_steps(f: Filter, rules: Rules, steps: Steps) -> None:
    """Begin a block: nothing is corrected of a unit step of a clock, or of a unit slip along the path or in heading."""
    sites = len(f.core.step_m)
    steps.used[0] = 0
    steps.left[:] = 0.0
    steps.score[:], steps.information[:] = 0.0, 0.0
    for site in range(sites):
        steps.left[site, f.core.first_offset + site] = 1.0
        if f.core.step_m[site] > 0.0 and rules.step > -math.inf:
            steps.used[0] = sites + 1
    steps.left[sites, 0], steps.left[sites, 1] = math.cos(f.x[3]), math.sin(f.x[3])
    steps.left[sites + 1, 3] = 1.0
    if rules.slip > -math.inf:
        steps.used[0] = sites + 2


@lean
def take_slip(f: Filter, rules: Rules, steps: Steps, moved: Floats) -> float:
    """End a block: correct the state by a slip of the wheels, as likely as it is; return what that adds to the
    log-likelihood.

    moved: distance (m) and turn (rad) of the block, as reported.
    """
    total, n, sites = 0.0, f.size[0], len(f.core.step_m)
    if rules.slip == -math.inf:
        return total
    for c in range(2):
        std = SLIP * abs(moved[c])
        if std == 0.0:
            continue
        found, left = _likely_size(steps, sites + c, std), steps.left[sites + c]
        odds = math.exp(min(rules.slip + found.gain, 100.0))
        q = odds / (1.0 + odds)
        if q > NO_SLIP:
            variance = q * (found.variance + (1.0 - q) * found.size**2)
            for i in range(n):
                f.x[i] += q * left[i] * found.size
                for j in range(n):
                    f.p[i, j] += left[i] * variance * left[j]
        total += math.log1p(odds) - math.log1p(math.exp(rules.slip))
    return total


@lean
def take_steps(f: Filter, rules: Rules, steps: Steps) -> float:
    """End a block: correct the state by the steps that are likelier than none and than a slip, as if the offset's
    variance had been open before it; return what that adds to the log-likelihood."""
    if steps.used[0] == 0:
        return 0.0
    total, n, sites = 0.0, f.size[0], len(f.core.step_m)
    slip = _likely_size(steps, sites, SLIP_M)
    for site in range(sites):
        if f.core.step_m[site] > 0.0:
            found, left = _likely_size(steps, site, f.core.step_m[site]), steps.left[site]
            gain = rules.step + found.gain
            if gain > max(slip.gain, 0.0):
                for i in range(n):
                    f.x[i] += left[i] * found.size
                    for j in range(n):
                        f.p[i, j] += left[i] * found.variance * left[j]
                total += gain
    return total


@lean
def _likely_size(steps: Steps, row: int, std_m: float) -> Shift:
    """Return the likeliest size of a step with this prior deviation, and the log-ratio of likelihoods."""
    information = steps.information[row] + 1.0 / std_m**2
    size, variance = steps.score[row] / information, 1.0 / information
    return Shift(size, variance, 0.5 * (size * steps.score[row] + math.log(variance / std_m**2)), 0)


@lean
def shift_clocks(f: Filter, b: Block, a: ArrayErrors, seen: Measured, s: Jacobian, w: Pairs) -> bool:
    """Shift the clock of each site whose measurements, as paired in w.slot_of, confirmed VTs explain if distances are
    shifted; return whether there is any. The evidence of a site that nothing explains adds up over snapshots in
    `b.shift`."""
    shifted, rules = False, seen.rules
    if rules.step == -math.inf:
        return False
    for site in range(len(f.core.step_m)):
        offset, step_m, (known, unknown) = f.core.first_offset + site, f.core.step_m[site], _explained(f, seen, site, w)
        if known > 0:
            b.shift[site] = 0.0
        least = AGREE if known > 0 else 1
        if step_m == 0.0 or unknown < least:
            continue
        found = _likely_shift(f, a, seen, site, s, w)
        if found.paired < least:
            continue
        prior = rules.step + 0.5 * (math.log(found.variance / step_m**2) - (found.size / step_m) ** 2)
        gain = found.gain if found.paired >= AGREE else min(found.gain, -prior / ALONE)
        if (found.size - b.shift[site, 0]) ** 2 <= rules.association.gate * found.variance:
            gain += b.shift[site, 1]
        b.shift[site, 0], b.shift[site, 1] = found.size, gain
        if gain + prior > 0.0:
            f.x[offset] += found.size
            f.p[offset, offset] += found.variance
            b.shift[site], shifted = 0.0, True
    return shifted


@lean
def _explained(f: Filter, seen: Measured, site: int, w: Pairs) -> tuple[int, int]:
    """Return how many measurements of a site are of confirmed VTs, and how many others have a distance."""
    known, unknown = 0, 0
    for link in range(len(seen.first) - 1):
        if seen.site_of[link] == site and f.links[link] == 1:
            for k in range(seen.first[link], seen.first[link + 1]):
                j = w.slot_of[k]
                if j >= 0 and f.vts.slots[j, HITS] >= seen.rules.lifetime.confirm:
                    known += 1
                elif not math.isnan(seen.z[k, 0]):
                    unknown += 1
    return known, unknown


@lean
def _ratio(f: Filter, a: ArrayErrors, seen: Measured, site: int, by: float, s: Jacobian, w: Pairs) -> tuple[float, int]:
    """Return the log-likelihood ratio to clutter of a site's measurements that are of confirmed VTs, if its clock is
    shifted `by` so many m, and how many there are."""
    offset, score, paired = f.core.first_offset + site, 0.0, 0
    before = f.x[offset]
    f.x[offset] += by
    for link in range(len(seen.first) - 1):
        if seen.site_of[link] == site and f.links[link] == 1 and seen.first[link + 1] > seen.first[link]:
            associate(f, a, seen, link, s, w)
            for k in range(seen.first[link + 1] - seen.first[link]):
                row = w.row_of[k]
                if row >= 0 and f.vts.slots[w.chosen[row], HITS] >= seen.rules.lifetime.confirm:
                    score += w.score[row, k]
                    paired += 1
    f.x[offset] = before
    return score, paired


@lean
def _likely_shift(f: Filter, a: ArrayErrors, seen: Measured, site: int, s: Jacobian, w: Pairs) -> Shift:
    """Return the shift of a site's distances that most measurements agree on; a measurement alone must be of a VT seen
    lately."""
    score, paired = _ratio(f, a, seen, site, 0.0, s, w)
    turned, rules, best = rotations_of(f), seen.rules, Shift(0.0, 1.0, 0.0, 0)
    gate = rules.association.gate
    for j in range(f.count[0]):
        link = f.vts.slots[j, LINK]
        if seen.site_of[link] != site or f.links[link] == 0 or f.vts.slots[j, HITS] < rules.lifetime.confirm:
            continue
        expected = expect(f, a, j, f.core.first_offset + site, turned, s)
        for k in range(seen.first[link], seen.first[link + 1]):
            i = innovate(difference(seen.z[k], expected.z), seen.noise.single[k], expected.hph)
            apart = i.e.y * i.e.y / i.s.yy + i.e.z * i.e.z / i.s.zz
            if math.isnan(seen.z[k, 0]) or apart > gate or i.e.x * i.e.x <= gate * i.s.xx:
                continue
            there, agree = _ratio(f, a, seen, site, i.e.x, s, w)
            recent = seen.now - f.vts.slots[j, LAST] <= RECENT
            if there - score > best.gain and (recent or agree - paired >= AGREE):
                best = Shift(i.e.x, i.s.xx, there - score, agree - paired)
    return best
