"""Held-out prediction: how well a filter, as it is at a moment of a drive, tells what will be measured after it.

At the moments t_i, a block apart, the filter is copied, and the copy goes on by the odometry alone. What is then
measured was never used; each measurement z of a link is scored by the logarithm of its density

    q(z) = e u(z) + (1 - e) / V sum_v N(z; h_v(x), H_v P H_v^T + R),    e = OTHER

x, P being pose, VTs and what they share, V confirmed VTs of the link, R all errors of one measurement, and u(z) how
measurements lie over the whole recording. R and u are the same for all filters that are compared, R the geometric mean
of what they assume: what counts is where pose and map are. The score of a block is the mean over its snapshots of the
mean over their measurements, in nats.

Blocks of 1, 2 and 4 parts of the drive, in turn, are some seconds long, and some minutes in a long drive. Two filters
are compared by the differences block by block.

Source: Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", Journal of the American
Statistical Association 102, 2007, section 4 (logarithmic score).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from cellslam.recordings.fitting.fit_tracks import robust_std
from cellslam.sim.compiling import njit
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.api import Snapshot, Step, setup_of, steps_of
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.sizes import Sheets
from cellslam.slam.joint.snapshot.observation_kernel import Jacobian, coordinates, geometry, new_jacobian, rotations_of
from cellslam.slam.joint.snapshot.update_kernel import covariance
from cellslam.slam.joint.state.layout import HITS, LINK, Filter
from cellslam.slam.measurements.fusion import white
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings import LEAST
from cellslam.slam.model.matrices_kernel import Vec3

CHANCE, LEAST_BLOCKS = 0.05, 5
OTHER = 0.1  # share of measurements that are of no VT that the filter knows
# Lengths of blocks in turn, how many turns a drive has at least and at most, and how long one is in between, s.
LENGTHS, LEAST_TURNS, MOST_TURNS, TURN_S = (1.0, 2.0, 4.0), 8, 20, 35.0
SCORED = 12  # snapshots of a block that count
WIDTHS = np.array([1.0, 2.0 * np.pi, 0.3])  # spread of distances and elevations at least, of azimuths, m and rad


@dataclass(frozen=True)
class Worth:
    """By how many nats a measurement of `blocks` is predicted better by one filter than by another, on average, and
    the standard deviation of that `mean`."""

    mean: float
    std: float
    blocks: int

    @property
    def sure(self) -> bool:
        """Whether it is better, and not by chance: Student's t test of paired differences, one-sided, of 5 %."""
        return self.blocks >= LEAST_BLOCKS and self.mean > self.std * float(stdtrit(self.blocks - 1, 1.0 - CHANCE))

    def __str__(self) -> str:
        if self.blocks < LEAST_BLOCKS:
            return "too few measurements to tell"
        return f"worth {self.mean:.2g} +- {self.std:.2g} nats a measurement that was not used, by {self.blocks} parts"


def compared(default: Floats, other: Floats) -> Worth:
    """Return how much better the scores (B,) of another filter are than those of the default."""
    gain = (other - default)[np.isfinite(other - default)]
    if len(gain) < LEAST_BLOCKS:
        return Worth(0.0, np.inf, len(gain))
    return Worth(float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain))), len(gain))


def scores(recording: Recording, sheets: Sheets, rivals: Sequence[MeasurementOptions]) -> Floats:
    """Return the score (B,), in nats, of each block of a drive by a filter that assumes `sheets`.

    `rivals`: all options that are compared; errors of one measurement have the geometric mean of their
    variances.
    """
    spread = Spread(recording, rivals)
    recording = replace(recording, odometry_model=sheets.odometry)
    estimator, steps = EkfSlam(sheets.options), steps_of(recording)
    estimator.start(setup_of(recording), np.random.default_rng(0))
    begins = blocks_of(recording.time_s)
    out = np.full(len(begins) - 1, np.nan)
    for i, (begin, end) in enumerate(pairwise(begins)):
        if i:
            out[i] = _block(estimator, steps[begin:end], spread)
        for step in steps[begin:end]:
            estimator.step(*step)
    return out[1:]


def blocks_of(time_s: Floats) -> Ints:
    """Return at which snapshots the blocks begin, and the number of snapshots."""
    lasts = float(time_s[-1] - time_s[0])
    turns = int(np.clip(lasts / TURN_S, LEAST_TURNS, MOST_TURNS))
    share = np.cumsum(np.tile(LENGTHS, turns)) / (turns * sum(LENGTHS))
    edges = time_s[0] + lasts * np.append(0.0, share[:-1])
    return np.append(np.unique(np.searchsorted(time_s, edges)), len(time_s))


class Spread:
    """How the measurements of each link lie over the whole recording: independent in distance, azimuth, elevation."""

    def __init__(self, recording: Recording, rivals: Sequence[MeasurementOptions]) -> None:
        self.rivals = rivals
        m = recording.measurements
        z = np.column_stack([m.distance_m, m.azimuth_rad, m.elevation_rad])
        self.middle, self.width = np.zeros((len(recording.links), 3)), np.ones((len(recording.links), 3))
        for link in np.unique(m.link):
            own = z[m.link == link]
            for c in (0, 2):
                if np.isfinite(own[:, c]).any():
                    self.middle[link, c] = np.nanmedian(own[:, c])
                    self.width[link, c] = max(robust_std(own[:, c]), WIDTHS[c])

    def log_density(self, link: Ints, z: Floats) -> Floats:
        """Return the log-density (m,) of measurements (m, 3), NaN where not measured."""
        log = -0.5 * ((z - self.middle[link]) / self.width[link]) ** 2 - np.log(np.sqrt(2.0 * np.pi) * self.width[link])
        log[:, 1] = np.where(np.isfinite(z[:, 1]), -np.log(WIDTHS[1]), np.nan)
        return np.asarray(np.nansum(log, axis=1))

    def log_score(self, snapshot: Snapshot) -> float:
        """Return the mean log-density of a snapshot's measurements."""
        return float(np.log(OTHER) + self.log_density(snapshot.link, columns(snapshot)).mean())


def columns(snapshot: Snapshot) -> Floats:
    """Return the measurements (m, 3) of a snapshot in m and rad, NaN where not measured."""
    return np.column_stack([snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad])


def _block(estimator: EkfSlam, steps: list[Step], spread: Spread) -> float:
    """Return the score of the snapshots of a block, which a copy of the filter goes through by odometry alone."""
    observed = [i for i, (*_, snapshot) in enumerate(steps) if len(snapshot)]
    if not observed:
        return float("nan")
    scored = {observed[i] for i in np.linspace(0, len(observed) - 1, min(SCORED, len(observed))).astype(int)}
    if estimator._joint is None:
        return float(np.mean([spread.log_score(steps[i][2]) for i in scored]))
    blind, found = copy.deepcopy(estimator), list[float]()
    mixture = blind._joint
    assert mixture is not None
    mixture.arrays.links[:] = 0  # it goes by its odometry
    for i, (dt_s, odometry, snapshot) in enumerate(steps[: max(scored) + 1]):
        blind.step(dt_s, odometry, snapshot)
        if i in scored:
            found.append(_log_score(blind, mixture, snapshot, spread))
    return float(np.mean(found))


def _log_score(filter_: EkfSlam, mixture: Mixture, snapshot: Snapshot, spread: Spread) -> float:
    """Return the mean log-density of a snapshot's measurements, where `mixture` of a filter is."""
    z, log = columns(snapshot), np.log(OTHER) + spread.log_density(snapshot.link, columns(snapshot))
    setup, options = filter_._setup, filter_._fusion.options
    link, h, spread_of = expected(mixture.likeliest, setup.links.site, options.confirm_hits, new_jacobian())
    group = filter_._fusion._group[snapshot.link]
    errors = [np.log(white(snapshot, one) + np.sum(one.persisting, axis=0) + LEAST) for one in spread.rivals]
    noise = np.exp(np.mean(errors, axis=0))
    for i in range(len(z)):
        own = link == group[i]
        if own.any():
            known = np.log1p(-OTHER) - np.log(own.sum()) + log_densities(z[i], h[own], spread_of[own], noise[i])
            log[i] = np.logaddexp.reduce(np.append(known, log[i]))
    return float(log.mean())


def log_densities(z: Floats, h: Floats, p: Floats, noise: Floats) -> Floats:
    """Return log N(z; h, p + diag noise) (n,) of a measurement z (3,), NaN where not measured, at VTs that are expected
    at h (n, 3) with covariances p (n, 3, 3)."""
    there = np.isfinite(z)
    e = z - h
    e[:, 1] = wrap_angle(e[:, 1])
    e, s = e[:, there], (p + np.diag(noise))[:, there][:, :, there]
    distance2 = np.einsum("ni,ni->n", e, np.linalg.solve(s, e[:, :, None])[:, :, 0])
    return np.asarray(-0.5 * (distance2 + np.linalg.slogdet(2.0 * np.pi * s)[1]))


@njit(cache=True)
def expected(f: Filter, site_of: Ints, confirm: int, s: Jacobian) -> tuple[Ints, Floats, Floats]:
    """Return the links (n,) of a filter's confirmed VTs, what it expects to measure of them (n, 3), in m and rad, and
    how well it knows that, H P H^T (n, 3, 3)."""
    slots, turned, here = f.vts.slots, rotations_of(f), Vec3(f.x[0], f.x[1], f.x[2])
    most, n = f.count[0], 0
    link, h, p = np.empty(most, np.int64), np.empty((most, 3)), np.empty((most, 3, 3))
    for j in range(most):
        if slots[j, HITS] < confirm:
            continue
        offset = f.core.first_offset + site_of[slots[j, LINK]]
        seen = geometry(f, j, offset, here, turned, coordinates(f, j), s)
        link[n], h[n, 0], h[n, 1], h[n, 2] = slots[j, LINK], seen.distance + f.x[offset], seen.azimuth, seen.elevation
        c = covariance(f, s)
        p[n, 0, 0], p[n, 0, 1], p[n, 0, 2], p[n, 1, 1], p[n, 1, 2], p[n, 2, 2] = c.xx, c.xy, c.xz, c.yy, c.yz, c.zz
        p[n, 1, 0], p[n, 2, 0], p[n, 2, 1] = c.xy, c.xz, c.yz
        n += 1
    return link[:n], h[:n], p[:n]
