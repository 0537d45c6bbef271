"""What the receiver knows of its own array, and of its motion during one snapshot.

Source: after RIMAX, Richter, "Estimation of radio channel parameters: models and algorithms", 2005; searched grid and
tapers: own, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, unit_vector
from cellslam.sim.lte.array import (
    AntennaArray,
    CircularArray,
    Complex,
    ComplexSingle,
    Floats,
    Steering,
    array_at,
    switching_times_s,
)
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.signal.path_estimator.acquire_kernel import Demands
from cellslam.sim.lte.signal.path_estimator.fit_kernel import DEGREE, MARGIN, STENCIL, DelayGrid
from cellslam.sim.lte.signal.path_estimator.search_kernel import Probe
from cellslam.sim.lte.signal.tone_reduction import ToneReduction, reduction_of
from cellslam.sim.lte.steering_kernel import SteeringModel, steer
from cellslam.sim.waveform.waveform import Waveform

AZIMUTHS, ELEVATIONS = 28, 7
LOWEST_RAD, HIGHEST_RAD = np.radians(-15.0), np.radians(60.0)
# Pitch of the searched distances at the bandwidth of 100 resource blocks of LTE, which lengths here are given for.
DELAY_PITCH_M, REFERENCE_BANDWIDTH_HZ = 7.5, 18e6
WIDEST_LTE_HZ = 20e6
TINY = np.float32(1e-30)
STRETCH_BINS = 31  # of delay in LTE, over which noise is taken for constant


@dataclass(frozen=True)
class Receiver:
    """The array as the receiver believes it to be, its switching, its search window. All but motion is constant.

    `times_s` (ports,): when each port is sampled; `tones_hz` (tones,): what is received, in a band of `bandwidth_hz`;
    `threshold`: detection threshold on energy over noise variance. The tones that are fitted are fewer, `fitted`.
    """

    array: AntennaArray = field(default_factory=CircularArray)
    times_s: Floats = field(default_factory=lambda: switching_times_s(CircularArray()))
    tones_hz: Floats = field(default_factory=lambda: LteWaveform().tones_hz)
    bandwidth_hz: float = REFERENCE_BANDWIDTH_HZ
    carrier_hz: float = 2.66e9
    threshold: float = 17.4
    window_min_m: float = -50.0
    window_max_m: float = 1700.0
    ghost_rule_db: float = 25.0

    @cached_property
    def fitted(self) -> ToneReduction:
        """The tones that are fitted, from those that are received."""
        return reduction_of(self.tones_hz, self.window_min_m, self.window_max_m)

    @cached_property
    def rate(self) -> Floats:
        """Phase of each fitted tone (groups,) in rad per m, counted from the middle: the weights take up the rest."""
        return phase_rate(self.fitted.tones_hz)

    @cached_property
    def demands(self) -> Demands:
        """What a path must fulfil, at this bandwidth."""
        return Demands(
            threshold=float(self.threshold), coarser=float(REFERENCE_BANDWIDTH_HZ / self.bandwidth_hz),
            ghost_share=10.0 ** (-self.ghost_rule_db / 10.0), window_min_m=float(self.window_min_m),
            window_max_m=float(self.window_max_m),
        )  # fmt: skip

    @cached_property
    def finer(self) -> float:
        """Resolution in distance over that of the widest LTE band, at most one."""
        return min(1.0, WIDEST_LTE_HZ / self.bandwidth_hz)

    @cached_property
    def stretch_bins(self) -> int:
        """Number of searched distances, odd, over which noise is taken for constant: as far as in LTE, or farther."""
        return int(STRETCH_BINS / self.finer) // 2 * 2 + 1

    @cached_property
    def pitch_m(self) -> float:
        """Step of the searched distances: somewhat less than half the resolution."""
        return DELAY_PITCH_M * self.demands.coarser

    @cached_property
    def delays_m(self) -> Floats:
        """Searched distances (D,) in m, with a margin on either side of the window."""
        beyond = MARGIN * self.pitch_m
        return np.arange(self.window_min_m - beyond, self.window_max_m + self.pitch_m + beyond, self.pitch_m)

    @cached_property
    def grid(self) -> DelayGrid:
        """What correlations with the tones of other distances are made from: shares are fitted to the tones."""
        way = np.linspace(-1.0, 1.0, 8 * DEGREE)
        places, between = np.arange(STENCIL) - 0.5 * (STENCIL - 1), 0.5 * way
        known, asked = (np.exp(-1j * np.outer(self.rate, self.pitch_m * at)) for at in (places, between))
        shares = np.linalg.lstsq(known, asked, rcond=1e-6)[0].real
        powers = np.linalg.lstsq(np.vander(way, DEGREE + 1, increasing=True), shares.T, rcond=None)[0]
        steps = np.arange(1.0 - len(self.delays_m), len(self.delays_m))
        alike = np.exp(1j * self.pitch_m * np.outer(steps, self.rate)).mean(axis=1).astype(np.complex64)
        return DelayGrid(self.delays_m, np.sqrt(len(self.rate)) * powers, alike, self.demands.coarser)

    @cached_property
    def delay_matrix(self) -> ComplexSingle:
        """Unit vectors (tones, D) that pick each searched distance."""
        matrix = np.exp(1j * np.outer(self.rate, self.delays_m)) / np.sqrt(len(self.rate))
        return np.ascontiguousarray(matrix, np.complex64)

    def at_distances(self, y: Complex | ComplexSingle) -> ComplexSingle:
        """Return samples (ports, tones), those received, correlated with the tones of the searched distances (ports,
        D)."""
        return np.asarray(self.fitted.of(y).astype(np.complex64) @ self.delay_matrix, np.complex64)

    @cached_property
    def directions(self) -> tuple[Floats, Floats]:
        """Searched azimuths and elevations (K,) in rad, azimuth by azimuth."""
        azimuth = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS - np.pi
        elevation = np.linspace(LOWEST_RAD, HIGHEST_RAD, ELEVATIONS)
        grid = np.meshgrid(azimuth, elevation, indexing="ij")
        return grid[0].ravel(), grid[1].ravel()

    @cached_property
    def apart(self) -> bool:
        """Whether every other port has the other slant: a direction's two beams then have ports of their own."""
        return isinstance(self.array, CircularArray)

    def by_set(self, values: Any) -> Any:
        """Return values (ports, n) as (2, P, n), of the ports that each of a direction's two beams sees."""
        if not self.apart:
            return np.broadcast_to(values, (2, *values.shape))
        return values.reshape(-1, 2, values.shape[1]).swapaxes(0, 1)

    @cached_property
    def _steering(self) -> Complex:
        """Steering vectors (2, K, P) of the searched directions: of each slant, or else of each polarisation."""
        value = self.array.steer(*self.directions).value
        return np.asarray(self._sets(value[:, :, 1]) if self.apart else np.moveaxis(value, -1, 0), np.complex128)

    def _sets(self, values: Complex) -> Complex:
        """Return values (n, ports) as (2, n, P), as `by_set` does."""
        return np.ascontiguousarray(self.by_set(values.T).swapaxes(1, 2))

    @cached_property
    def doppler(self) -> Floats:
        """Phase of each port per speed towards the wave (ports,), rad per m/s, zero on average."""
        later = self.times_s - self.times_s.mean()
        return np.asarray(2.0 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_MPS * later, np.float64)

    def moving(self, velocity_mps: Floats) -> Motion:
        """Return the receiver in motion with body velocity (3,) in m/s."""
        factor = np.ones(self.array.ports, np.complex128)
        return Motion(self, np.asarray(velocity_mps, np.float64), factor)


def receiver_of(waveform: Waveform, carrier_hz: float = 2.66e9, **more: Any) -> Receiver:
    """Return the receiver of a waveform, its array built for the carrier; `more`: other fields."""
    array = array_at(carrier_hz)
    own: dict[str, Any] = {"array": array, "times_s": switching_times_s(array), "carrier_hz": carrier_hz}
    return Receiver(tones_hz=waveform.tones_hz, bandwidth_hz=waveform.bandwidth_hz, **(own | more))


def phase_rate(tones_hz: Floats) -> Floats:
    """Return the phase of tones (tones,), in Hz, in rad per m of delay, counted from the middle tone."""
    return np.asarray(2.0 * np.pi * (tones_hz - tones_hz.mean()) / SPEED_OF_LIGHT_MPS, np.float64)


def energy_of(vectors: ComplexSingle) -> NDArray[np.float32]:
    """Return the squared norms (...) of vectors (..., P)."""
    return np.asarray(np.square(vectors.view(np.float32)).sum(axis=-1), np.float32)


@dataclass(frozen=True)
class Motion:
    """The receiver during one snapshot: it steers with the Doppler phase of its velocity (3,), and weighs its ports.

    `factor` (ports,): zero for a dead port, less than one for a port with more disturbance than others.
    """

    receiver: Receiver
    velocity_mps: Floats
    factor: Complex

    def weighed(self, weight: Floats) -> Motion:
        """Return the same with ports weighed by `weight` (ports,)."""
        motion = Motion(self.receiver, self.velocity_mps, np.asarray(weight, np.complex128))
        motion.__dict__["turned"] = self.turned
        return motion

    @cached_property
    def turned(self) -> ComplexSingle:
        """Steering vectors (2, K, P) of the searched directions, Doppler included."""
        r = self.receiver
        phase = np.outer(unit_vector(*r.directions) @ self.velocity_mps, r.doppler)
        return np.asarray(r._steering * r._sets(np.exp(1j * phase)), np.complex64)

    @cached_property
    def beams(self) -> ComplexSingle:
        """Beams (2, K, P) of the search: orthonormal bases of what a direction's two polarisations can do."""
        both: ComplexSingle = (self.turned * self.receiver._sets(self.factor[None]).astype(np.complex64)).conj()
        if not self.receiver.apart:  # else the two belong to different ports, and are orthogonal as they are
            h, v = both
            v -= np.sum(h.conj() * v, axis=1, keepdims=True) / np.maximum(energy_of(h), TINY)[:, None] * h
        both *= 1.0 / np.sqrt(np.maximum(energy_of(both), TINY))[..., None]
        return both

    @cached_property
    def probe(self) -> Probe:
        """What the compiled search looks at samples with."""
        r = self.receiver
        return Probe(self.beams, r.grid, *r.directions)

    @cached_property
    def model(self) -> SteeringModel:
        """What the kernels steer with, Doppler included."""
        r = self.receiver
        return r.array.moving(self.factor, r.doppler, self.velocity_mps, r.rate)

    def steer(self, azimuth_rad: Floats, elevation_rad: Floats) -> Steering:
        """Return steering vectors (n, ports, 2) and derivatives of directions (n,) in rad, Doppler included."""
        return Steering(*steer(azimuth_rad, elevation_rad, self.model))
