"""The particle set: blocks of states and maps, initial draw, copying at resampling.

Source: Murray, Lee and Jacob, "Parallel resampling in the particle filter", J. Computational and Graphical Statistics
25(3), 2016: ancestors permuted so that survivors stay in place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from cellslam.sim.randomness import quasi_random
from cellslam.sim.recording import Floats, Ints, OdometryModel
from cellslam.slam.api import Setup
from cellslam.slam.fastslam.snapshot.motion_kernel import driven
from cellslam.slam.fastslam.state.copy_kernel import move_between, move_within
from cellslam.slam.fastslam.state.layout import BIAS, BOUND, LANES, POSE, POSE_G, RECORD, SCALE, THETA, Blocks, Tracks
from cellslam.slam.fastslam.state.tracks_kernel import DEAD, UNKNOWN

YAW_RATE, SPEED = 3, 0  # components of u whose bias and scale are marginalised


@dataclass(frozen=True)
class Particles:
    """State of N = 32 G particles with K nuisances (S offsets, their rates where clocks drift, yaw-rate bias, odometer
    scale), C tracks in each of L maps.

    state (G, F * 32) and records (G, L, C, 27 * 32): rows of `layout`; status (G, L, C, 32): -1 where a particle does
    not believe in a track, else 4 * snapshot last seen + class; alike (G, L, C): that of all 32 lanes, or UNKNOWN;
    ident (G, L, C): measurement that the track was born from; order (G, L, C): a permutation, its first counts[g, l]
    are in use; bounds (G, L, BOUND, C): what the track could show when last predicted (see `candidates_kernel._bound`);
    travelled (G, K - 1): how far the particles and a site's offset have moved, m, and how far directions have turned,
    rad; log_weight (G, 32).
    """

    state: Floats
    status: NDArray[np.int32]
    alike: NDArray[np.int32]
    records: NDArray[np.float32]
    ident: Ints
    order: NDArray[np.int32]
    counts: Ints
    bounds: NDArray[np.float32]
    travelled: Floats
    log_weight: Floats

    def __len__(self) -> int:
        return len(self.state) * LANES

    @property
    def nuisances(self) -> int:
        """K."""
        return int(self.travelled.shape[1]) + 1

    @property
    def record(self) -> int:
        """Rows of a track's record."""
        return int(self.records.shape[3]) // LANES

    @property
    def held(self) -> Blocks:
        """All of it as the kernels take it."""
        tracks = Tracks(self.status, self.alike, self.records, self.ident, self.order, self.counts, self.bounds)
        return Blocks(self.state, tracks, self.travelled, self.log_weight)

    def rows(self, first: int, count: int) -> Floats:
        """Return a view (G, count, 32) of `count` rows of the state."""
        return self.state.reshape(len(self.state), -1, LANES)[:, first : first + count]

    def columns(self, first: int, count: int) -> Floats:
        """Return a copy (N, count) of `count` rows of the state, particle by particle."""
        return np.swapaxes(self.rows(first, count), 1, 2).reshape(-1, count)


def draw(
    setup: Setup, count: int, component_std_m: float, capacity: int, rng: np.random.Generator, maps: int | None = None,
    record: int = RECORD, sampled_motion: bool = False,
) -> Particles:  # fmt: skip
    """Draw the prior: start pose, sampled odometry errors, and one component of the offset prior for each particle.

    `capacity`: tracks of each of `maps` maps (one a link), of so many rows a `record`. sampled_motion: yaw-rate bias
    and odometer scale are drawn like the other errors.

    The number of particles is rounded up to a multiple of 32. The offset prior N(m, s^2) is split into components of
    deviation
    min(s, component_std_m) whose means are N(m, s^2 - component^2), placed by a quasi-random sequence (one wide
    Gaussian is
    linearised too far from the truth).
    """
    sites, model = setup.sites, setup.odometry_model
    rates = sites.drift_std_m_s if (sites.drift_std_m_s > 0.0).any() else np.zeros(0)
    blocks, size = -(-count // LANES), len(sites) + len(rates) + 2
    particles = _empty(blocks, size, maps or len(setup.links), capacity, record)
    prior = sites.clock_offset_std_m
    component = np.minimum(prior, component_std_m)
    spread = np.sqrt(prior**2 - component**2)
    n = len(particles)

    def fill(row: int, values: Floats) -> None:
        particles.rows(row, values.shape[1])[:] = np.swapaxes(values.reshape(blocks, LANES, -1), 1, 2)

    fill(POSE, setup.start_pose + setup.start_std * rng.standard_normal((n, 6)))
    bias, scale = model.bias * rng.standard_normal((n, 6)), model.scale * rng.standard_normal((n, 6))
    marginalised = np.array([model.bias[YAW_RATE], model.scale[SPEED]])
    if sampled_motion:
        marginalised[:] = 0.0
    else:
        bias[:, YAW_RATE], scale[:, SPEED] = 0.0, 0.0
    fill(BIAS, bias)
    fill(SCALE, scale)
    fill(THETA, sites.clock_offset_mean_m + spread * ndtri(quasi_random(n, len(sites), rng)))
    variances = np.concatenate([component**2, rates**2, marginalised**2])
    fill(THETA + size, np.tile(np.diag(variances).ravel(), (n, 1)))
    return particles


def _empty(blocks: int, size: int, maps: int, capacity: int, record: int) -> Particles:
    shape = (blocks, maps, capacity)
    return Particles(
        state=np.zeros((blocks, (THETA + size + size * size) * LANES)),
        status=np.full((*shape, LANES), DEAD, np.int32),
        alike=np.full(shape, UNKNOWN, np.int32),
        records=np.zeros((*shape, record * LANES), np.float32),
        ident=np.zeros(shape, np.int64),
        order=np.broadcast_to(np.arange(capacity, dtype=np.int32), shape).copy(),
        counts=np.zeros((blocks, maps), np.int64),
        bounds=np.zeros((blocks, maps, BOUND, capacity), np.float32),
        travelled=np.zeros((blocks, size - 1)),
        log_weight=np.zeros((blocks, LANES)),
    )


def widened(particles: Particles, capacity: int) -> Particles:
    """Return the same particles with room for `capacity` tracks a link."""
    p = particles
    blocks, maps, old = p.order.shape
    wide = _empty(blocks, p.nuisances, maps, capacity, p.record)
    for name in ("status", "alike", "records", "ident", "order"):
        getattr(wide, name)[:, :, :old] = getattr(p, name)
    wide.bounds[:, :, :, :old] = p.bounds
    return replace(wide, state=p.state, counts=p.counts, travelled=p.travelled, log_weight=p.log_weight)


def draw_velocities(
    particles: Particles, model: OdometryModel, dt_s: float, odometry: Floats, rng: np.random.Generator
) -> Floats:
    """Return body velocities (G, 6, 32) drawn from the odometry (6,), in m/s and rad/s, less each particle's own errors
    of it, whose biases walk on."""
    noise = np.zeros(6)
    if dt_s > 0.0:
        noise[:] = model.noise_density / math.sqrt(dt_s)
        bias = particles.rows(BIAS, 6)
        for c in np.flatnonzero(model.bias_walk_density):
            bias[:, c] += model.bias_walk_density[c] * np.sqrt(dt_s) * rng.standard_normal((len(bias), LANES))
    drawn = rng.standard_normal((np.count_nonzero(noise), len(particles.state), LANES))
    velocity: Floats = driven(particles.state, odometry, noise, drawn)
    return velocity


def select(particles: Particles, ancestors: Ints) -> Particles:
    """Return the particles named by `ancestors` (count,), which share no memory, with equal weights.

    With the count unchanged survivors stay where they are and only the places of particles without children are
    overwritten, from within their block where that is possible.
    """
    if len(ancestors) != len(particles):
        return _regrouped(particles, ancestors)
    children = np.bincount(ancestors, minlength=len(particles)).reshape(-1, LANES)
    within, between = _moves(children)
    _carry_out(particles, particles, within, between)
    particles.log_weight[:] = 0.0
    return particles


def _moves(children: Ints) -> tuple[list[tuple[int, int, int]], list[tuple[int, int, int, int]]]:
    """Return moves within blocks (block, from lane, to lane) and between blocks (block, lane, to block, to lane)."""
    within, spare, places = [], [], []
    for block, row in enumerate(children):
        source = np.repeat(np.arange(LANES), np.maximum(row - 1, 0))
        target = np.flatnonzero(row == 0)
        local = min(len(source), len(target))
        within += [(block, int(a), int(b)) for a, b in zip(source[:local], target[:local], strict=True)]
        spare += [(block, int(a)) for a in source[local:]]
        places += [(block, int(b)) for b in target[local:]]
    return within, [(*a, *b) for a, b in zip(spare, places, strict=True)]


def _regrouped(particles: Particles, ancestors: Ints) -> Particles:
    """Return a set of another size: every particle is copied to its new place."""
    blocks = len(ancestors) // LANES
    capacity, maps = particles.order.shape[2], particles.order.shape[1]
    fresh = _empty(blocks, particles.nuisances, maps, capacity, particles.record)
    moves = [(int(a) // LANES, int(a) % LANES, i // LANES, i % LANES) for i, a in enumerate(ancestors)]
    _carry_out(particles, fresh, [], moves)
    return fresh


def _carry_out(
    source: Particles, target: Particles, within: list[tuple[int, int, int]], between: list[tuple[int, int, int, int]]
) -> None:
    if within:
        steps = np.array(within, np.int64)
        starts = np.searchsorted(steps[:, 0], np.arange(len(source.state) + 1))
        move_within(steps, starts, source.state, source.held.tracks)
    if between:
        move_between(np.array(between, np.int64), source.state, source.held.tracks, target.state, target.held.tracks)


__all__ = ["POSE_G", "Particles", "draw", "draw_velocities", "select"]
