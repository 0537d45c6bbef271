"""Path estimator of one link: search, one-path fits, joint maximum-likelihood fit, model order (RIMAX-type).

After Richter, "Estimation of radio channel parameters: models and algorithms", 2005: strongest path first, joint
refinement, reliability by the Fisher information; local disturbance instead of a parametric diffuse model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from cellslam.sim.errors import InputError
from cellslam.sim.lte import search_kernel
from cellslam.sim.lte.array import Complex, Floats
from cellslam.sim.lte.detector_model import GHOST_REACH_M
from cellslam.sim.lte.receiver import AZIMUTHS, DELAY_PITCH_M, ELEVATIONS, HIGHEST_RAD, LOWEST_RAD, Motion, Receiver
from cellslam.sim.lte.refine import Fit, covariance, factors, refine, synthesise

COARSE = 0.58  # share of the threshold at which a cell is looked at: the grid loses up to 2.4 dB
MOST_FAILURES = 4  # cells that turn out to be noise before the search ends
MOST_PATHS = 32
JOINT_EVERY = 4
# A saturated port's residual exceeds the others' by this, and is this share of its power; calibration errors leave 1 %.
_SATURATED_EXCESS, _SATURATED_SHARE = 6.0, 0.25
_FARTHEST = np.array([3.0 * DELAY_PITCH_M, np.radians(20.0)])  # that a fit may end from its cell
_STRETCH_BINS = 31  # of delay, over which noise is taken for constant
_UNEVEN = 1.5  # times the usual disturbance, from which a port is weighed: less is scatter
_LEAST_RELIABLE = np.array([8.0, np.radians(16.0), np.radians(20.0)])


@dataclass(frozen=True)
class Estimates:
    """Paths (n,) of one link: `geometry` (n, 3) distance in m, azimuth, elevation in rad; `covariance` (n, 3, 3);
    `snr_db` (n,) mean signal over disturbance per sample; `statistic` (n,) energy over disturbance.
    """

    geometry: Floats
    covariance: Floats
    snr_db: Floats
    statistic: Floats

    def __len__(self) -> int:
        return len(self.geometry)


NOTHING = Estimates(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0), np.empty(0))


def estimate_paths(y: Complex, motion: Motion, start: Floats | None = None) -> Estimates:
    """Return the paths in a link's samples (ports, tones); `start` (n, 3): geometry to begin with (tracking).

    Ports that deliver nothing, or nothing finite, are left out; so are saturated ones, whose samples the paths of the
    other ports do not explain. Raises InputError where no port delivers anything.
    """
    working: NDArray[np.bool_] = np.logical_and(np.isfinite(y).all(axis=1), y.any(axis=1))
    if not working.any():
        raise InputError("no array port delivered samples: all are zero or not finite")
    link = _estimated(y, motion, working, start)
    sound = np.logical_and(working, ~link.saturated())
    if not np.array_equal(sound, working):
        link = _estimated(y, motion, sound, start)
    return link.result()


def _estimated(y: Complex, motion: Motion, working: NDArray[np.bool_], start: Floats | None) -> _Link:
    weight = _port_weights(y, working, motion.receiver)
    if not (weight == 1.0).all():
        y = np.asarray(np.where(working[:, None], y, 0.0) * weight[:, None], np.complex128)
        motion = motion.weighed(weight)
    link = _Link(np.ascontiguousarray(y, np.complex128), motion)
    if start is not None and len(start):
        link.fit_jointly(start)
    link.search()
    return link


def _port_weights(y: Complex, working: NDArray[np.bool_], receiver: Receiver) -> Floats:
    """Return weights (ports,) that make the disturbance alike: a port that faces an interferer counts less.

    The disturbance of a port is the median over delays, whose resolved paths are few; zero for ports out of work.
    """
    tapered = np.where(working[:, None], y, 0.0).astype(np.complex64) @ receiver.quiet_matrix
    level = np.median(tapered.real**2 + tapered.imag**2, axis=1).astype(np.float64)
    usual = float(np.median(level[working]))
    uneven = level > _UNEVEN * usual
    return np.where(working, np.where(uneven, np.sqrt(usual / np.maximum(level, 0.1 * usual)), 1.0), 0.0)


class _Link:
    """Working state of one link and snapshot: the fit so far, the residual and its spectrum."""

    def __init__(self, y: Complex, motion: Motion) -> None:
        self.y, self.motion, self.receiver = y, motion, motion.receiver
        self.residual = y
        self.geometry = np.empty((0, 3))
        self.fit: Fit | None = None
        self.level = np.empty(0)
        self.spectrum: _Spectrum | None = None

    def fit_jointly(self, geometry: Floats) -> None:
        """Refine all paths, drop what does not pass, and look at the residual anew."""
        noise = self._noise(geometry)
        while len(geometry):
            fit = refine(self.y, self.motion, geometry, noise)
            self.residual = self.y - synthesise(self.motion, fit)
            self.spectrum = _Spectrum(self.residual, self.motion)
            noise = self.spectrum.noise
            level, quiet = self.spectrum.levels(fit.geometry)
            weakest = _weakest(fit, level, quiet, self.receiver)
            if weakest < 0:
                self.fit, self.geometry, self.level = fit, fit.geometry, level
                return
            geometry = np.delete(fit.geometry, weakest, axis=0)
        self.fit, self.geometry, self.level = None, geometry, np.empty(0)
        self.residual, self.spectrum = self.y, _Spectrum(self.y, self.motion)

    def search(self) -> None:
        """Add paths, the strongest first, until nothing more stands out."""
        blocked: list[tuple[int, int]] = []
        pending: list[Floats] = []
        failures, most = 0, len(self.geometry)
        spectrum = self.spectrum or _Spectrum(self.y, self.motion)
        while True:
            full = len(self.geometry) + len(pending) >= MOST_PATHS
            found = None
            if failures < MOST_FAILURES and not full:
                found = spectrum.strongest(COARSE * self.receiver.threshold, blocked)
            if found is None or len(pending) >= JOINT_EVERY:
                if not pending:
                    return
                spectrum = self._accept(pending)
                pending = []
                if len(self.geometry) > most:
                    # The joint fit has changed the residual: what was tried in vain is worth another look.
                    most, failures, blocked = len(self.geometry), 0, []
                else:
                    failures += 1
                continue
            start, cell, level = found
            # A cell is tried once: what the joint fit drops must not come back for ever.
            blocked.append(cell)
            margin = search_kernel.DIFFUSE_MARGIN if level > spectrum.profile[cell[1]] else 1.0
            asked = self.receiver.threshold * level * margin
            fit = refine(self.residual, self.motion, start[None, :], level, promising=0.85 * asked / level)
            away = np.abs(fit.geometry[0] - start)[[0, 2]]
            if fit.normal.explained < asked or (away > _FARTHEST).any():
                failures += 1
                continue
            pending.append(fit.geometry[0])
            self.residual = self.residual - synthesise(self.motion, fit)
            spectrum.subtract(fit)

    def _accept(self, pending: list[Floats]) -> _Spectrum:
        self.fit_jointly(np.concatenate([self.geometry, np.array(pending)]))
        assert self.spectrum is not None
        return self.spectrum

    def _noise(self, geometry: Floats) -> float:
        if self.spectrum is not None:
            return self.spectrum.noise
        return float(np.mean(np.abs(self.residual) ** 2)) / (10.0 if len(geometry) else 1.0)

    def saturated(self) -> NDArray[np.bool_]:
        """Return which ports (ports,) hold much that no path explains: a share of their power and far over the rest."""
        left, power = (np.mean(np.abs(x) ** 2, axis=1) for x in (self.residual, self.y))
        usual = np.median(left[power > 0.0])
        return np.array((left > _SATURATED_EXCESS * usual) & (left > _SATURATED_SHARE * power), np.bool_)

    def result(self) -> Estimates:
        """Return what was found, sorted by distance."""
        if self.fit is None:
            return NOTHING
        energy = self.fit.normal.wald
        strength = np.sum(np.abs(factors(self.motion, self.fit)[0]) ** 2, axis=1) / len(self.y)
        order = np.argsort(self.geometry[:, 0], kind="stable")
        snr_db = 10.0 * np.log10(np.maximum(strength / self.level, 1e-12))
        spread = covariance(self.fit, self.level)
        return Estimates(self.geometry[order], spread[order], snr_db[order], (energy / self.level)[order])


class _Spectrum:
    """Delay-direction spectrum of a residual: beam outputs (2 K, D), port outputs (ports, D), noise per sample."""

    def __init__(self, residual: Complex, motion: Motion) -> None:
        self.motion, self.receiver = motion, motion.receiver
        self.ports = residual.astype(np.complex64) @ self.receiver.delay_matrix
        self.beams = motion.beams @ self.ports
        self._look()

    def subtract(self, fit: Fit) -> None:
        """Take a path out of the spectrum, in place: an update of rank one."""
        on_ports, on_tones = (f[0].astype(np.complex64) for f in factors(self.motion, fit))
        delay = on_tones @ self.receiver.delay_matrix
        search_kernel.subtract_outer(self.ports, on_ports, delay)
        search_kernel.subtract_outer(self.beams, self.motion.beams @ on_ports, delay)
        self._look()

    def _look(self) -> None:
        count, bins = len(self.beams) // 2, self.beams.shape[1]
        self.energy = np.empty((count, bins), np.float32)
        search_kernel.direction_energy(self.beams, self.energy)
        self.running = np.empty((count, bins + 1))
        search_kernel.surrounding_sums(self.energy, AZIMUTHS, ELEVATIONS, self.running)
        self.port_energy = np.sum(self.ports.real**2 + self.ports.imag**2, axis=0)
        self.working = int(np.count_nonzero(self.motion.factor))
        # Cancelling another cell colours the noise over delay: level by level, as paths fill few cells of a stretch.
        self.profile = median_filter(self.port_energy / self.working, _STRETCH_BINS, mode="nearest").astype(np.float64)
        self.noise = float(np.median(self.profile))

    def strongest(self, coarse: float, blocked: list[tuple[int, int]]) -> tuple[Floats, tuple[int, int], float] | None:
        """Return geometry (3,), cell and disturbance of the strongest cell that stands out; None: there is none."""
        cells = np.array(blocked, np.int64).reshape(-1, 2)
        k, d, level = search_kernel.strongest(
            self.energy, self.running, self.port_energy, self.profile, coarse, ELEVATIONS, self.working, cells
        )
        if k < 0:
            return None
        azimuth, elevation = self.receiver.directions
        return np.array([self.receiver.delays_m[d], azimuth[k], elevation[k]]), (k, d), level

    def levels(self, geometry: Floats) -> tuple[Floats, Floats]:
        """Return the disturbance per sample (n,) around each of the paths that were taken out, and the noise there."""
        out, noise = np.empty(len(geometry)), np.empty(len(geometry))
        step = (HIGHEST_RAD - LOWEST_RAD) / (ELEVATIONS - 1)
        for i, (distance, azimuth, elevation) in enumerate(geometry):
            d = int(np.rint((distance - self.receiver.delays_m[0]) / DELAY_PITCH_M))
            d = min(max(d, 0), len(self.receiver.delays_m) - 1)
            e = min(max(int(np.rint((elevation - LOWEST_RAD) / step)), 0), ELEVATIONS - 1)
            k = int(np.rint((azimuth + np.pi) / (2.0 * np.pi) * AZIMUTHS)) % AZIMUTHS * ELEVATIONS + e
            noise[i] = self.profile[d]
            out[i] = search_kernel.local_level(k, d, 0.0, self.running, self.port_energy, self.working, noise[i])
        return out, noise


def _weakest(fit: Fit, level: Floats, noise: Floats, receiver: Receiver) -> int:
    """Return the path to be dropped: below the threshold, unreliable, outside the window or a ghost; -1: none."""
    statistic = fit.normal.wald / level
    std = np.sqrt(np.einsum("nii->ni", covariance(fit, level)))
    margin = np.where(level > noise, search_kernel.DIFFUSE_MARGIN, 1.0)
    bad = (statistic < receiver.threshold * margin) | (std > _LEAST_RELIABLE).any(axis=1)
    distance = fit.geometry[:, 0]
    bad |= (distance < receiver.window_min_m) | (distance > receiver.window_max_m)
    near = np.abs(distance[:, None] - distance[None, :]) < GHOST_REACH_M
    rule = 10.0 ** (-receiver.ghost_rule_db / 10.0)
    bad |= (near & (fit.normal.wald[:, None] < rule * fit.normal.wald[None, :])).any(axis=1)
    if not bad.any():
        return -1
    return int(np.argmin(np.where(bad, statistic, np.inf)))
