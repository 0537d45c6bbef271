"""Where a particle's motion is drawn from: parts of the filter."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from cellslam.sim.recording import Floats, OdometryModel
from cellslam.slam.fastslam.snapshot.motion_kernel import driven
from cellslam.slam.fastslam.state.layout import BIAS, LANES
from cellslam.slam.fastslam.state.particles import SPEED, YAW_RATE, Particles


class Sight(Protocol):
    """What a snapshot says of displacement ahead and turn, of particles that move by `velocity` (G, 6, 32): y and I
    (G, 5, 32) over (m, rad)."""

    def __call__(self, velocity: Floats) -> Floats:
        """Return what is seen."""
        ...


class Proposal(Protocol):
    """Draws body velocities (G, 6, 32), one for each particle, and corrects the particles' log-weights."""

    def __call__(
        self, particles: Particles, model: OdometryModel, dt_s: float, odometry: Floats, sight: Sight,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Return velocities."""
        ...


class FromMotion:
    """The motion model: what was measured, less sampled errors (FastSLAM 1.0)."""

    def __call__(
        self, particles: Particles, model: OdometryModel, dt_s: float, odometry: Floats, sight: Sight,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Return velocities; the weights stay as they are."""
        noise = np.zeros(6)
        if dt_s > 0.0:
            noise[:] = model.noise_density / math.sqrt(dt_s)
            walk(particles, model, dt_s, rng)
        drawn = rng.standard_normal((np.count_nonzero(noise), len(particles.state), LANES))
        velocity: Floats = driven(particles.state, odometry, noise, drawn)
        return velocity


class FromMeasurements:
    """The motion model conditioned on the snapshot, linearised (FastSLAM 2.0, Montemerlo et al. 2003): noise in speed
    and yaw rate is drawn from its posterior, and the weight takes prior over proposal."""

    def __call__(
        self, particles: Particles, model: OdometryModel, dt_s: float, odometry: Floats, sight: Sight,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Return velocities, and add log prior less log proposal to the weights."""
        if dt_s <= 0.0:
            return FromMotion()(particles, model, dt_s, odometry, sight, rng)
        others = np.array(model.noise_density)
        own = others[[SPEED, YAW_RATE]] / np.sqrt(dt_s)
        others[[SPEED, YAW_RATE]] = 0.0
        rest = OdometryModel(others, model.bias, model.bias_walk_density, model.scale)
        velocity = FromMotion()(particles, rest, dt_s, odometry, sight, rng)
        seen = np.asarray(sight(velocity), np.float64) * np.array([1, 1, dt_s, dt_s, dt_s])[:, None] * dt_s
        # Over unit normal noise: M = 1 + s I s, mean M^-1 s y; M = L L^T, noise = mean + L^-T n.
        scale = own[:, None, None]
        y = scale * np.stack([seen[:, 0], seen[:, 1]])
        m00, m01, m11 = 1.0 + own[0] ** 2 * seen[:, 2], own[0] * own[1] * seen[:, 3], 1.0 + own[1] ** 2 * seen[:, 4]
        l00 = np.sqrt(m00)
        l10 = m01 / l00
        l11 = np.sqrt(np.maximum(m11 - l10**2, 1e-12))
        drawn = rng.standard_normal(y.shape)
        first = y[0] / l00 + drawn[0]
        second = (y[1] - l10 * y[0] / l00) / l11 + drawn[1]
        noise_b = second / l11
        noise_a = (first - l10 * noise_b) / l00
        particles.log_weight[:] += 0.5 * np.sum(drawn**2, axis=0) - 0.5 * (noise_a**2 + noise_b**2) - np.log(l00 * l11)
        velocity[:, SPEED] += own[0] * noise_a
        velocity[:, YAW_RATE] += own[1] * noise_b
        return velocity


def walk(particles: Particles, model: OdometryModel, dt_s: float, rng: np.random.Generator) -> None:
    """Let the sampled biases walk on."""
    bias = particles.rows(BIAS, 6)
    for c in np.flatnonzero(model.bias_walk_density):
        bias[:, c] += model.bias_walk_density[c] * np.sqrt(dt_s) * rng.standard_normal((len(bias), LANES))


PROPOSALS: dict[str, Proposal] = {"motion": FromMotion(), "measurements": FromMeasurements()}
