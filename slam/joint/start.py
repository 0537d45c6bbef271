"""The start: clock offsets are too wide for one linearisation, so each site has a mixture of narrow components.

A Gaussian sum over the offset of one site at a time, not over all at once: the sites share nothing but the pose, which
odometry knows well at the start, so S mixtures of K filters do in place of K^S filters. When one offset is known well
enough and few combinations of components are left, these go through the drive so far once more, all sites together:
what one site says of the pose tells the components of another apart. They go on if they end where the mixtures do.

Source: Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums", Automatica 7, 1971.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from heapq import nlargest
from itertools import product
from operator import itemgetter

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup
from cellslam.slam.joint.calibration_states import begin_with
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.mixture import Mixture, side_by_side
from cellslam.slam.joint.new_filters import new_mixture
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.state.layout import POSE, ArrayErrors, Core, Measured
from cellslam.slam.model.pose_moments import known_together, mixture_moments

REACH = 4.0  # the components cover this many deviations of the prior
COMBINATIONS, LEAST = 32, 0.001  # of components that go on, and how likely each must be against the best of its site
PRUNE_EVERY = 8  # snapshots
MOST_FILTERS = 2048  # of all sites together, of which each uses 0.3 MB or more
KNOWN_M2 = 1e-6  # variance of a place, or heading, that is known
RETURN_LOG_ODDS = -4.0  # from which on a VT unseen for a while may be the one that is seen
GATE = 16.3  # squared Mahalanobis distance, chi-square of three: one of a thousand that are right is beyond it
SHORTER = 40  # weights of the roof leave so many times sooner than after the start: a filter for each component
START_STATES = 440  # of a filter: memory that is not used costs nothing; growing does, and rows 4096 bytes apart


def width_of_components(std_m: Floats, options: EkfSlamOptions) -> float:
    """Return the width, in m, of the components of priors N(0, std_m^2), (S,): that of the options, or a greater one
    where these would be more than MOST_FILTERS."""
    least = 2.0 * REACH * float(std_m.sum()) / (options.component_step * MOST_FILTERS)
    return max(options.component_std_m, least)


def components(std_m: float, component_std_m: float, step: float) -> tuple[Floats, Floats, float]:
    """Return means (K,), log-weights (K,) and deviation of the components of a prior N(0, std_m^2), in m."""
    if std_m <= component_std_m:
        return np.zeros(1), np.zeros(1), std_m
    spread = float(np.sqrt(std_m**2 - component_std_m**2))
    half = int(np.ceil(REACH * spread / (step * component_std_m)))
    means = step * component_std_m * np.arange(-half, half + 1)
    logs = -0.5 * (means / spread) ** 2
    return np.asarray(means), np.asarray(logs - np.log(np.exp(logs).sum())), component_std_m


@dataclass
class Start:
    """A mixture for each site, whose offset is its own, and one of a filter that knows `odometry` alone; `errors`:
    those that are states in each filter."""

    core: Core
    errors: ArrayErrors
    mixtures: list[Mixture]
    odometry: Mixture
    site: Ints
    options: EkfSlamOptions

    def use(self, interval: Interval, measured: Measured) -> Ints:
        """Use a snapshot in every mixture, drop what has become unlikely; return the likeliest filters' association
        (m,)."""
        answer = np.full(len(measured.z), -1, np.int64)
        # A mixture of one site does not know its pose well enough to tell VTs that return, it refuses what is
        # improbable; nor to tell merged paths.
        rules = measured.rules
        rules = rules._replace(
            association=rules.association._replace(return_log_odds=RETURN_LOG_ODDS),
            lifetime=rules.lifetime._replace(hold=rules.lifetime.hold // SHORTER),
            merge_rate=0.0,
        )
        measured, ends = measured._replace(rules=rules), measured.now % PRUNE_EVERY == 0
        site_of_measurement = np.repeat(self.site, np.diff(measured.first))
        *associations, _ = side_by_side(
            [*self.mixtures, self.odometry], self.errors, interval, measured, self.options.vts
        )
        for site, (mixture, association) in enumerate(zip(self.mixtures, associations, strict=True)):
            mine = site_of_measurement == site
            answer[mine] = association[mixture.best, mine]
            if not ends:
                continue
            at = self.core.first_offset + site
            kept = mixture.apart(slice(at, at + 1), self.options.prune_ratio)
            if len(kept) < len(mixture):
                mixture.keep(kept)
        return answer

    def moments(self) -> tuple[Floats, Floats]:
        """Return the means (S, c), in m and rad, and covariances (S, c, c) of what `Mixture.moments` has, of each
        mixture."""
        means, covariances = zip(*(mixture.moments() for mixture in self.mixtures), strict=True)
        return np.array(means), np.array(covariances)

    def offsets(self, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """Return mean (S,) in m and variance (S,) in m^2 of the clock offsets, each by the mixture of its site."""
        site = np.arange(len(means))
        at = self.core.first_offset + site
        return means[site, at], np.maximum(covariances[site, at, at], 0.0)

    def pose(self, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """Return the pose (6,), in m and rad, and its covariance (6, 6): the mean over the mixtures, weighted by how
        well each knows its place; what they know together, and as much more as the mean of such errs that are so far
        apart.
        """
        x, p, weight = self._weighted(means, covariances)
        mean, apart = mixture_moments(weight, x, np.zeros_like(p))
        known = known_together(p, self.odometry.arrays.p[0, :POSE, :POSE])
        return mean, known + apart / max(len(x) - 1, 1)

    def _weighted(self, means: Floats, covariances: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the poses (S, 6), their covariances (S, 6, 6) and weights (S,)."""
        x, p = means[:, :POSE], covariances[:, :POSE, :POSE]
        weight = 1.0 / (p[:, 0, 0] + p[:, 1, 1] + KNOWN_M2)
        return x, p, weight / weight.sum()

    def agrees(self, state: Floats) -> bool:
        """Return whether place and yaw of a state (n,), in m and rad, may be those of one mixture or another."""
        x, p, weight = self._weighted(*self.moments())
        (mean, covariance), at = mixture_moments(weight, x, p), [0, 1, 3]
        apart = state[at] - mean[at]
        apart[2] = wrap_angle(apart[2])
        return bool(apart @ np.linalg.solve(covariance[np.ix_(at, at)] + KNOWN_M2 * np.eye(3), apart) < GATE)

    def likeliest(self) -> list[tuple[Mixture, int]]:
        """Return each mixture and its likeliest filter."""
        return [(mixture, mixture.best) for mixture in self.mixtures]

    def over(self, variance_m2: Floats) -> bool:
        """Return whether joint filters can take over, the variances (S,) of the offsets being these: one offset is
        resolved, and the combinations are few; or all are."""
        known_m = self.options.resolved_share * self.options.typical_range_m
        resolved, few = variance_m2 <= known_m**2, math.prod(map(len, self._likely()))
        return bool(resolved.all() or (resolved.any() and few <= COMBINATIONS))

    def combinations(self) -> Floats:
        """Return the likeliest combinations of offsets (C, S), in m."""
        found: list[tuple[tuple[float, ...], float]] = [((), 0.0)]
        for likely in self._likely():  # of the first sites the likeliest go on: there are too many to sort at the end
            more = (((*means, mean), log + own) for (means, log), (mean, own) in product(found, likely))
            found = nlargest(COMBINATIONS, more, key=itemgetter(1))
        return np.array([means for means, _ in found])

    def _likely(self) -> list[list[tuple[float, float]]]:
        """Return the offsets, in m, of the likely components of each site, and the logarithms of their weights."""
        likely = []
        for site, mixture in enumerate(self.mixtures):
            mean, w = mixture.arrays.x[: len(mixture), self.core.first_offset + site], mixture.weights()
            likely.append([(float(mean[i]), math.log(w[i])) for i in np.flatnonzero(w >= LEAST * w.max())])
        return likely


def begin(setup: Setup, core: Core, errors: ArrayErrors, options: EkfSlamOptions) -> Start:
    """Return the mixtures at the start."""
    sites, mixtures = setup.sites, []
    for site in range(len(sites)):
        std_m = float(sites.clock_offset_std_m[site])
        means, logs, std = components(std_m, options.component_std_m, options.component_step)
        offsets = np.tile(np.asarray(sites.clock_offset_mean_m, np.float64), (len(means), 1))
        offsets[:, site] += means
        own = np.where(np.arange(len(sites)) == site, std, 0.0)
        mixture = new_mixture(setup, core, errors, offsets, own, options.vts, START_STATES)
        mixture.arrays.links[:], mixture.beside = setup.links.site == site, len(sites) - 1
        mixture.influence.rest += logs
        mixture.log_weight += logs
        if options.known_calibration is not None:
            begin_with(mixture, errors, options.known_calibration)
        mixtures.append(mixture)
    none = np.zeros(len(sites))
    odometry = new_mixture(setup, core, errors, none[None], none, 1, core.size)
    odometry.arrays.links[:] = 0
    return Start(core, errors, mixtures, odometry, setup.links.site, options)
