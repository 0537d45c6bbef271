"""The particle set: arrays of states and maps, initial draw, copying at resampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup
from cellslam.slam.fastslam.layout import RECORD
from cellslam.slam.fastslam.map_kernel import copy_maps, gather_maps

YAW_RATE, SPEED = 3, 0  # components of u whose bias and scale are marginalised


@dataclass(frozen=True)
class Particles:
    """State of N particles with K = S + 2 nuisances (offsets, yaw-rate bias, odometer scale) and C VT records a link.

    pose (N, 6); pose_g (N, 6): d(x, y, psi)/d(bias, scale), row by row; theta (N, K), cov (N, K, K): nuisance mean and
    covariance; bias (N, 6), scale (N, 6): sampled errors of the other components, and all bias walks; records (N, L,
    C, 32),
    counts (N, L): maps; log_weight (N,).
    """

    pose: Floats
    pose_g: Floats
    theta: Floats
    cov: Floats
    bias: Floats
    scale: Floats
    records: Floats
    counts: Ints
    log_weight: Floats

    def __len__(self) -> int:
        return len(self.pose)


def draw(setup: Setup, count: int, component_std_m: float, capacity: int, rng: np.random.Generator) -> Particles:
    """Draw the prior: start pose, sampled odometry errors, and one component of the offset prior for each particle.

    The offset prior N(m, s^2) is split into components of deviation min(s, component_std_m) whose means are N(m, s^2 -
    component^2), placed by a quasi-random sequence (one wide Gaussian is linearised too far from the truth).
    """
    sites, model = setup.sites, setup.odometry_model
    size = len(sites) + 2
    prior = sites.clock_offset_std_m
    component = np.minimum(prior, component_std_m)
    spread = np.sqrt(prior**2 - component**2)
    theta = np.zeros((count, size))
    theta[:, : len(sites)] = sites.clock_offset_mean_m + spread * ndtri(quasi_random(count, len(sites), rng))
    variances = np.concatenate([component**2, [model.bias[YAW_RATE] ** 2, model.scale[SPEED] ** 2]])
    bias = model.bias * rng.standard_normal((count, 6))
    scale = model.scale * rng.standard_normal((count, 6))
    bias[:, YAW_RATE] = 0.0
    scale[:, SPEED] = 0.0
    links = len(setup.links)
    return Particles(
        pose=setup.start_pose + setup.start_std * rng.standard_normal((count, 6)),
        pose_g=np.zeros((count, 6)),
        theta=theta,
        cov=np.tile(np.diag(variances), (count, 1, 1)),
        bias=bias,
        scale=scale,
        records=np.empty((count, links, capacity, RECORD)),
        counts=np.zeros((count, links), np.int64),
        log_weight=np.zeros(count),
    )


def quasi_random(count: int, dimensions: int, rng: np.random.Generator) -> Floats:
    """Return `count` points (count, dimensions) in the open unit cube: Roberts' R-sequence, randomly shifted.

    Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018): steps by powers of the root of
    x^(d + 1) = x + 1.
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    points = (rng.random(dimensions) + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.clip(points, 1e-9, 1 - 1e-9)


def select(particles: Particles, ancestors: Ints) -> Particles:
    """Return the particles named by `ancestors` (count,), which share no memory: survivors stay, the dead are
    overwritten.

    With the count unchanged the arrays are reused and only maps of particles that have more than one child are copied.
    """
    count = len(particles)
    if len(ancestors) != count:
        return _gather(particles, ancestors)
    source, target = _moves(np.bincount(ancestors, minlength=count))
    for array in (
        particles.pose,
        particles.pose_g,
        particles.theta,
        particles.cov,
        particles.bias,
        particles.scale,
    ):
        array[target] = array[source]
    copy_maps(particles.records, particles.counts, source, target)
    particles.log_weight[:] = 0.0
    return particles


def _moves(children: Ints) -> tuple[Ints, Ints]:
    """Return (source, target): each surplus child of a survivor goes to the place of a particle without children."""
    return np.repeat(np.arange(len(children)), np.maximum(children - 1, 0)), np.flatnonzero(children == 0)


def _gather(particles: Particles, ancestors: Ints) -> Particles:
    p = particles
    records = np.empty((len(ancestors), *p.records.shape[1:]))
    counts = p.counts[ancestors]
    gather_maps(p.records, counts, ancestors, records)
    return Particles(
        pose=p.pose[ancestors],
        pose_g=p.pose_g[ancestors],
        theta=p.theta[ancestors],
        cov=p.cov[ancestors],
        bias=p.bias[ancestors],
        scale=p.scale[ancestors],
        records=records,
        counts=counts,
        log_weight=np.zeros(len(ancestors)),
    )
