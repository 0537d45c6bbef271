"""What `python -m tools front-end` measures of the path estimator: detection, errors, resolution, ghosts, motion.

Scenes are synthetic: paths of given SNR per sample at unit noise, seen by the array of 64 dual-polarised patches.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import (
    AntennaArray,
    CircularArray,
    Complex,
    Floats,
    PathSet,
    Steering,
    array_at,
    miscalibrated,
    switching_times_s,
)
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.signal.path_estimator.cancellation import cancel
from cellslam.sim.lte.signal.path_estimator.path_estimator import Estimates, estimate_paths
from cellslam.sim.lte.signal.receiver import Motion, Receiver, receiver_of
from cellslam.sim.lte.signal.signal_front_end import GAIN_STD_DB, PHASE_STD_DEG
from cellslam.sim.nr.nr_waveform import NrWaveform
from cellslam.sim.waveform import Waveform
from tools.front_end_reference import doppler_phasors, frequency_response, joint_std

# Carrier, waveform and detection threshold of the receivers under test: 20 MHz of LTE, 100 MHz of NR with as few false
# paths over five times as many delays.
RECEIVERS: dict[str, tuple[float, Waveform, float]] = {
    "lte": (2.66e9, LteWaveform(), 17.4),
    "nr": (3.5e9, NrWaveform(), 19.2),
}
STILL = np.zeros(3)
Row = dict[str, Any]


@dataclass(frozen=True)
class Bench:
    """The receiver under test and its tones."""

    receiver: Receiver

    @property
    def array(self) -> AntennaArray:
        """What the receiver believes of its array."""
        return self.receiver.array

    @property
    def tones_hz(self) -> Floats:
        """Frequencies of the reference tones (tones,), in Hz."""
        return self.receiver.tones_hz

    def draw(self, rng: np.random.Generator, rho_db: Floats, reach_m: float) -> PathSet:
        """Draw paths (n,) of given SNR per sample, anywhere within `reach_m` and up to 40 degrees above the horizon."""
        n = len(rho_db)
        distance, azimuth = rng.uniform(20.0, 20.0 + reach_m, n), rng.uniform(-np.pi, np.pi, n)
        elevation = rng.uniform(-0.05, 0.7, n)
        weights = rng.standard_normal((n, 2)) + 1j * rng.standard_normal((n, 2))
        return self.scaled(PathSet(distance, azimuth, elevation, weights), rho_db)

    def scaled(self, paths: PathSet, rho_db: Floats) -> PathSet:
        """Return the paths with weights that give them the SNR per sample `rho_db` (n,) at unit noise."""
        value = self.array.steer(paths.azimuth_rad, paths.elevation_rad).value
        signal = np.einsum("npq,nq->np", value, paths.weights)
        level = 10.0 ** (np.asarray(rho_db) / 20.0) / np.sqrt(np.mean(np.abs(signal) ** 2, axis=1))
        return PathSet(paths.distance_m, paths.azimuth_rad, paths.elevation_rad, paths.weights * level[:, None])

    def channel(self, paths: PathSet, velocity: Floats = STILL, array: AntennaArray | None = None) -> Complex:
        """Return the noiseless samples (ports, tones) of the paths, seen with `array` (None: the believed one)."""
        seen = array or self.array
        return frequency_response(seen, self.tones_hz, self.receiver.times_s, velocity, paths, self.receiver.carrier_hz)

    def noise(self, rng: np.random.Generator) -> Complex:
        """Return unit noise (ports, tones)."""
        pair = rng.standard_normal((2, self.array.ports, len(self.tones_hz)))
        return np.asarray((pair[0] + 1j * pair[1]) / np.sqrt(2.0), np.complex128)

    def estimate(self, y: Complex, velocity: Floats = STILL, start: Floats | None = None) -> Estimates:
        """Return the paths found in samples (ports, tones)."""
        return estimate_paths(y, self.receiver.moving(velocity), start)


def errors(paths: PathSet, found: Estimates) -> tuple[Floats, np.ndarray]:
    """Return the error (n, 3) of each path's own estimate (NaN: none within 15 m and 29 degrees), and its row."""
    truth = np.stack([paths.distance_m, paths.azimuth_rad, paths.elevation_rad], 1)
    error, row = np.full(truth.shape, np.nan), np.zeros(len(truth), np.int64)
    apart = found.geometry[None] - truth[:, None]
    apart[..., 1] = wrap_angle(apart[..., 1])
    cost = np.sum((apart / np.array([15.0, 0.5, 0.5])) ** 2, axis=-1)
    for i, j in zip(*linear_sum_assignment(np.minimum(cost, 1.0)), strict=True):
        if cost[i, j] < 1.0:
            error[i], row[i] = apart[i, j], j
    return error, row


@lru_cache(maxsize=4)
def default_bench(technology: str = "lte", order: Literal["column", "ring"] = "column") -> Bench:
    """Return the bench of the paper's receiver, or of the same for another waveform of RECEIVERS."""
    carrier_hz, waveform, threshold = RECEIVERS[technology]
    times_s = switching_times_s(array_at(carrier_hz), order)
    return Bench(receiver_of(waveform, carrier_hz, times_s=times_s, threshold=threshold))


def single_path(bench: Bench, rho_db: float, runs: int, rng: np.random.Generator) -> Row:
    """One path: detection probability, RMSE over the bound, error over the claimed deviation, false paths."""
    to_bound, to_claim, found, false = [], [], 0, 0
    for _ in range(runs):
        paths = bench.draw(rng, np.array([rho_db]), 1500.0)
        result = bench.estimate(bench.channel(paths) + bench.noise(rng))
        error, row = errors(paths, result)
        hit = bool(np.isfinite(error).all())
        found, false = found + hit, false + len(result) - hit
        if hit:
            to_bound.append(error[0] / joint_std(bench.array, bench.tones_hz, paths, 1.0)[0])
            to_claim.append(error[0] / np.sqrt(np.diag(result.covariance[row[0]])))
    return {
        "rho_db": rho_db, "runs": runs, "detected": found / runs, "false": false / runs,
        "rmse_over_bound": _rms(to_bound), "error_over_claim": _rms(to_claim),
    }  # fmt: skip


def many_paths(bench: Bench, count: int, runs: int, rng: np.random.Generator) -> Row:
    """`count` paths over 600 m, -30 to 0 dB: found, false, found when tracked, errors over the joint bound."""
    found = false = tracked = tracked_false = 0
    ratio: list[Floats] = []
    for _ in range(runs):
        paths = bench.draw(rng, rng.uniform(-30.0, 0.0, count), 600.0)
        clean = bench.channel(paths)
        result = bench.estimate(clean + bench.noise(rng))
        again = bench.estimate(clean + bench.noise(rng), start=result.geometry)
        for tally, estimates in enumerate((result, again)):
            error, _ = errors(paths, estimates)
            hit = int(np.isfinite(error).all(axis=1).sum())
            if tally:
                tracked, tracked_false = tracked + hit, tracked_false + max(len(estimates) - count, 0)
            else:
                found, false = found + hit, false + max(len(estimates) - count, 0)
                ratio.extend(error[np.isfinite(error).all(axis=1)] / joint_std(
                    bench.array, bench.tones_hz, paths, 1.0)[np.isfinite(error).all(axis=1)])  # fmt: skip
    return {
        "paths": count, "runs": runs, "found": found / runs, "false": false / runs, "tracked": tracked / runs,
        "tracked_false": tracked_false / runs, "rmse_over_bound": _rms(ratio), "median_over_bound": _median(ratio),
    }  # fmt: skip


def resolution(
    bench: Bench, gamma_db: float, component: int, steps: Floats, runs: int, rng: np.random.Generator
) -> Row:
    """Two equal paths apart in one component (0 m, 1 and 2 rad): from where on both are found half the time, and
    the normalised error (3 degrees of freedom) of those that count as resolved.
    """
    rho_db = np.full(2, gamma_db - 10.0 * np.log10(bench.array.ports * len(bench.tones_hz)))
    share, normalised = [], []
    for step in steps:
        both = 0
        for _ in range(runs):
            one = bench.draw(rng, rho_db[:1], 300.0)
            geometry = np.array([[one.distance_m[0], one.azimuth_rad[0], min(one.elevation_rad[0], 0.4)]] * 2)
            geometry[1, component] += step
            weights = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
            paths = bench.scaled(PathSet(geometry[:, 0], geometry[:, 1], geometry[:, 2], weights), rho_db)
            result = bench.estimate(bench.channel(paths) + bench.noise(rng))
            pairs = _pairs(geometry, result, step, component)
            both += pairs is not None
            if pairs is not None:
                normalised.extend(_normalised(geometry, result, pairs))
        share.append(both / runs)
    return {
        "gamma_db": gamma_db, "component": ("distance", "azimuth", "elevation")[component],
        "steps": list(map(float, steps)), "resolved": share, "half_at": _half(steps, share),
        "normalised_median": _median(normalised), "normalised_99": _quantile(normalised, 0.99),
        "normalised_inside": _share(normalised, 11.345),
    }  # fmt: skip


def collision(bench: Bench, ratio_db: float, runs: int, rng: np.random.Generator) -> Row:
    """A weak cell under one that shares its reference elements and is `ratio_db` stronger; calibration errors."""
    slots = 20 + np.arange(bench.array.ports)
    lte = LteWaveform()
    codes = {c: np.array([lte.values((c, 0), 3, int(s % lte.slots)) for s in slots]) for c in (375, 177)}
    found = false = total = 0
    for _ in range(runs):
        array = _spoilt(bench, rng)
        weak = bench.draw(rng, rng.uniform(-20.0, 0.0, 4), 600.0)
        strong = bench.draw(rng, np.array([ratio_db - 20.0, ratio_db - 30.0, ratio_db - 35.0]), 600.0)
        mixed = bench.channel(weak, array=array) * codes[375] + bench.channel(strong, array=array) * codes[177]
        cleaned = cancel((mixed + bench.noise(rng)) * codes[375].conj(), lte, (375, 0), (177, 0), 3, slots)
        result = bench.estimate(cleaned)
        hit = int(np.isfinite(errors(weak, result)[0]).all(axis=1).sum())
        found, total, false = found + hit, total + len(weak), false + max(len(result) - hit, 0)
    return {"ratio_db": ratio_db, "runs": runs, "detected": found / total, "false": false / runs}


def ghosts(bench: Bench, rho_db: float, runs: int, rng: np.random.Generator) -> Row:
    """One strong path through an array with calibration errors: how many more are reported."""
    extra = 0
    for _ in range(runs):
        paths = bench.draw(rng, np.array([rho_db]), 600.0)
        extra += max(len(bench.estimate(bench.channel(paths, array=_spoilt(bench, rng)) + bench.noise(rng))) - 1, 0)
    return {"rho_db": rho_db, "runs": runs, "ghosts": extra / runs}


def motion(technology: str, order: Literal["column", "ring"], speed_mps: float, runs: int, seed: int) -> Row:
    """One path seen in motion with known velocity, against the same path at rest: ratios (3,) of RMSE and of bound.

    The noise is turned with the wave's Doppler phase, so that both estimates meet the same.
    """
    bench, velocity = default_bench(technology, order), np.array([speed_mps, 0.0, 0.0])
    moving: list[Floats] = []
    at_rest: list[Floats] = []
    bounds: list[list[Floats]] = []
    still, in_motion = bench.array, _InMotion(bench.receiver.moving(velocity))
    for run in range(runs):
        scene = np.random.default_rng([seed, run])
        paths = bench.draw(scene, np.array([-10.0]), 1500.0)
        noise = bench.noise(scene)
        times = bench.receiver.times_s
        turn = doppler_phasors(times, velocity, paths.azimuth_rad, paths.elevation_rad, bench.receiver.carrier_hz)[0]
        bounds.append([joint_std(a, bench.tones_hz, paths, 1.0)[0] for a in (in_motion, still)])
        for velocity_now, sink, added in ((velocity, moving, turn[:, None] * noise), (STILL, at_rest, noise)):
            result = bench.estimate(bench.channel(paths, velocity_now) + added, velocity_now)
            sink.append(errors(paths, result)[0][0])
    ratio = np.sqrt(np.nanmean(np.square(moving), axis=0) / np.nanmean(np.square(at_rest), axis=0))
    bound = np.sqrt(np.mean(np.square(bounds), axis=0))
    return {
        "order": order, "speed_mps": speed_mps, "runs": runs, "rmse_over_rest": ratio.tolist(),
        "bound_over_rest": (bound[0] / bound[1]).tolist(),
    }  # fmt: skip


@dataclass(frozen=True)
class _InMotion:
    """A moving array: the Doppler phase of its known velocity belongs to the steering, and to its derivatives."""

    motion: Motion

    @property
    def ports(self) -> int:
        return self.motion.receiver.array.ports

    def steer(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Steering:
        return self.motion.steer(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))


def _spoilt(bench: Bench, rng: np.random.Generator) -> CircularArray:
    assert isinstance(bench.array, CircularArray)
    return miscalibrated(bench.array, PHASE_STD_DEG, GAIN_STD_DB, rng)


def _pairs(geometry: Floats, found: Estimates, step: float, component: int) -> list[int] | None:
    """Return which estimates belong to the two paths; None unless each is within half the step of its own."""
    rows = []
    for truth in geometry:
        apart = found.geometry - truth
        apart[:, 1] = wrap_angle(apart[:, 1])
        near = np.flatnonzero((np.abs(apart[:, component]) < 0.5 * step) & (np.abs(apart[:, 0]) < 15.0))
        if not len(near):
            return None
        rows.append(int(near[np.argmin(np.abs(apart[near, component]))]))
    return rows if rows[0] != rows[1] else None


def _normalised(geometry: Floats, found: Estimates, rows: list[int]) -> list[float]:
    error = found.geometry[rows] - geometry
    error[:, 1] = wrap_angle(error[:, 1])
    return [float(e @ np.linalg.solve(c, e)) for e, c in zip(error, found.covariance[rows], strict=True)]


def _half(steps: Floats, share: list[float]) -> float | None:
    """Return the first step, interpolated, at which the share reaches one half; None: never."""
    for i, value in enumerate(share):
        if value >= 0.5:
            if i == 0:
                return float(steps[0])
            part = (0.5 - share[i - 1]) / (value - share[i - 1])
            return float(steps[i - 1] + part * (steps[i] - steps[i - 1]))
    return None


def _rms(values: list[Any]) -> list[float]:
    return np.sqrt(np.mean(np.square(values), axis=0)).tolist() if len(values) else []


def _median(values: list[Any]) -> Any:
    return (np.median(np.abs(values), axis=0) / (0.6745 if np.ndim(values) > 1 else 1.0)).tolist() if values else None


def _quantile(values: list[float], q: float) -> float | None:
    return float(np.quantile(values, q)) if values else None


def _share(values: list[float], limit: float) -> float | None:
    return float(np.mean(np.array(values) < limit)) if values else None
