"""Path estimator of one link: search, one-path fits, joint maximum-likelihood fit, model order (RIMAX-type).

Samples y (ports x tones) of n paths at theta = (distance d, azimuth, elevation), with linear weights w_p in C^2

    model       y = A(theta) w + noise;   column (p, q) of A is b_q(az_p, el_p) (x) exp(-j 2 pi f d_p / c)
    weights     G = A^H A,  b = A^H y,  w = G^-1 b:  they are eliminated            `fit_kernel._normal_equations`
    explained   E(theta) = b^H G^-1 b, maximised by Levenberg-Marquardt             `fit_kernel.climb`
    Jacobian    D = d(A w) / d theta,  C = D^H A
      information  J = Re(D^H D - C G^-1 C^H),   gradient  g = Re(D^H (y - A w))    `fit_kernel._normal_equations`
      step         (J + lambda diag J) step = g                                     `fit_kernel.climb`
    energy      W_p = w_p^H ((G^-1)_pp)^-1 w_p: what would be lost with path p      `fit_kernel._wald`
    search      the strongest peak (direction k, delay d) of the residual's energy
                that exceeds the threshold times its surroundings                   `search_kernel.standing_out`
    order       p stays while W_p > threshold sigma_p^2, sigma_p^2: the
                disturbance around it, and while its deviations are small           `acquire_kernel.judged`
    covariance  sigma_p^2 (2 J)^-1                                                  `acquire_kernel.judged`

`_Link.search` says in which order: paths one by one, joint fits in between. All numbers that decide: `thresholds`.

Source: after Richter, "Estimation of radio channel parameters: models and algorithms", 2005: strongest path first,
joint refinement, reliability by the Fisher information; local disturbance instead of a parametric diffuse model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import CircularArray, Complex, ComplexSingle, Floats
from cellslam.sim.lte.signal.path_estimator import thresholds
from cellslam.sim.lte.signal.path_estimator.acquire_kernel import Trials, add_paths, judged
from cellslam.sim.lte.signal.path_estimator.fit_kernel import NO_NORMAL, Normal, climb
from cellslam.sim.lte.signal.path_estimator.spectrum import Spectrum
from cellslam.sim.lte.signal.receiver import Motion, Receiver, energy_of


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


class Fit(NamedTuple):
    """A joint fit of paths at `geometry` (n, 3), m, rad, rad: normal equations there, disturbance around each path
    `level` (n,), their covariances (n, 3, 3).
    """

    geometry: Floats
    normal: Normal
    level: Floats
    covariance: Floats


_NO_FIT = Fit(np.empty((0, 3)), NO_NORMAL, np.empty(0), np.empty((0, 3, 3)))


def estimate_paths(y: Complex | ComplexSingle, motion: Motion, start: Floats | None = None) -> Estimates:
    """Return the paths in a link's samples (ports, tones); `start` (n, 3) in m, rad, rad: to begin with (tracking).

    Ports that deliver nothing, or nothing finite, are left out; so are saturated ones, whose samples the paths of the
    other ports do not explain. Raises InputError where no port delivers anything, and for samples of another shape.
    """
    expected = (motion.receiver.array.ports, len(motion.receiver.tones_hz))
    if y.shape != expected:
        raise InputError(f"samples of shape {y.shape}: {expected} (array ports, tones) are expected")
    working: NDArray[np.bool_] = np.logical_and(np.isfinite(y).all(axis=1), y.any(axis=1))
    if not working.any():
        raise InputError("no array port delivered samples: all are zero or not finite")
    samples = motion.receiver.at_distances(y if working.all() else np.where(working[:, None], y, 0.0))
    link = _estimated(samples, motion, working, start)
    sound = np.logical_and(working, ~link.saturated())
    if not np.array_equal(sound, working):
        link = _estimated(samples, motion, sound, start)
    return link.result()


def _estimated(samples: ComplexSingle, motion: Motion, working: NDArray[np.bool_], start: Floats | None) -> _Link:
    weight = _port_weights(samples, working, motion.receiver)
    if not (weight == 1.0).all():
        samples, motion = samples * weight[:, None].astype(np.float32), motion.weighed(weight)
    link = _Link(samples, motion)
    if start is not None and len(start):
        link.fit_jointly(start, thresholds.FINE_GAIN)
    link.search()
    return link


def _port_weights(samples: ComplexSingle, working: NDArray[np.bool_], receiver: Receiver) -> Floats:
    """Return weights (ports,) that make the disturbance alike: a port that faces an interferer counts less.

    The disturbance of a port is the median over delays, whose resolved paths are few; its neighbours two steps away
    make of each, nearly, what a Hann taper over the tones would, so that little is left of a path far from its delay.
    Ports of one column and slant face the same way: their mean is taken where they agree. Zero for ports out of work.
    """
    tapered = samples[:, 2:-2:2] + np.float32(0.5) * (samples[:, :-4:2] + samples[:, 4::2])
    level = _median(tapered.real**2 + tapered.imag**2).astype(np.float64)
    if isinstance(receiver.array, CircularArray):
        level = _agreeing(level, working, receiver.array.rings)
    usual = float(_median(level[working]))
    even = (np.abs(np.log(np.maximum(level[working], 1e-300) / usual)) < thresholds.UNEVEN).all()
    weight = np.ones(len(samples)) if even else np.sqrt(usual / np.maximum(level, 0.1 * usual))
    return np.where(working, weight, 0.0)


def _agreeing(level: Floats, working: NDArray[np.bool_], rings: int) -> Floats:
    """Return `level` (ports,), replaced by the mean of its column and slant where it is within a factor of two."""
    parts, counted = level.reshape(-1, rings, 2), working.reshape(-1, rings, 2)
    median = _median(parts.swapaxes(1, 2))[:, None]
    alike = counted & (parts < 2.0 * median) & (parts > 0.5 * median)
    mean = np.sum(parts * alike, axis=1, keepdims=True) / np.maximum(np.sum(alike, axis=1, keepdims=True), 1)
    return np.asarray(np.where(alike, mean, parts).reshape(-1), np.float64)


def _median(values: NDArray[Any]) -> NDArray[Any]:
    """Return the median over the last axis; np.median takes ten times as long."""
    ordered, count = np.sort(values, axis=-1), values.shape[-1]
    return np.asarray(0.5 * (ordered[..., (count - 1) // 2] + ordered[..., count // 2]))


class _Link:
    """Working state of one link and snapshot: the fit so far, the residual and its spectrum."""

    def __init__(self, samples: ComplexSingle, motion: Motion) -> None:
        self.motion, self.receiver = motion, motion.receiver
        self.fit, self.fine = _NO_FIT, False
        self.spectrum = Spectrum(samples, motion)

    def search(self) -> None:
        """Add paths, the strongest first, until nothing more stands out."""
        trials, most = _untried(), len(self.fit.geometry)
        while True:
            found = np.empty((min(thresholds.JOINT_EVERY, thresholds.MOST_PATHS - len(self.fit.geometry)), 3))
            added, trials = add_paths(
                self.spectrum.residual, *self.spectrum.parts, self.motion.probe, trials, self.receiver.demands,
                self.motion.model, found,
            )  # fmt: skip
            if not added:
                break
            self.fit_jointly(np.concatenate([self.fit.geometry, found[:added]]))
            if len(self.fit.geometry) > most:
                # The joint fit has changed the residual: what was tried in vain is tried again.
                trials, most = _untried(), len(self.fit.geometry)
            else:  # What the joint fit drops must not come back for ever.
                trials = Trials(trials.cells, trials.tried, trials.failures + 1)
        if not self.fine:
            self.fit_jointly(self.fit.geometry, thresholds.FINE_GAIN)
        self.unite()

    def fit_jointly(self, start: Floats, least_gain: float = thresholds.COARSE_GAIN) -> None:
        """Refine all paths, drop what does not pass, and look at the residual again."""
        self.fine = least_gain == thresholds.FINE_GAIN
        while len(start):
            geometry, normal = self._climbed(start, least_gain)
            self.spectrum.leave(geometry, normal)
            level, covariance, kept = judged(
                geometry, normal, *self.spectrum.parts, self.motion.probe, self.receiver.demands
            )
            if kept.all():
                self.fit = Fit(geometry, normal, level, covariance)
                break
            start = geometry[kept]
        else:
            self.fit = _NO_FIT
            self.spectrum.leave(*self.fit[:2])

    def _climbed(self, start: Floats, least_gain: float) -> tuple[Floats, Normal]:
        """Return geometry (n, 3) and normal equations of the joint fit that starts at `start` (n, 3)."""
        start = np.ascontiguousarray(start, np.float64)
        least = least_gain * self.spectrum.noise
        geometry, normal = climb(self.spectrum.samples, self.receiver.grid, start, least, 0.0, self.motion.model)
        return geometry, Normal(*normal)

    def unite(self) -> None:
        """Drop each path that a close stronger one can stand for: a fit without it explains as much."""
        tried = 0
        while 1 < len(self.fit.geometry) > tried:
            near = _beside_stronger(self.fit, self.receiver)
            order = [i for i in np.argsort(self.fit.normal.wald) if near[i]]
            if tried >= len(order):
                return
            i = order[tried]
            alone, normal = self._climbed(np.delete(self.fit.geometry, i, axis=0), thresholds.FINE_GAIN)
            if self.fit.normal.explained - normal.explained < self.receiver.threshold * self.fit.level[i]:
                self.fit_jointly(alone, thresholds.FINE_GAIN)
                tried = 0
            else:
                tried += 1

    def saturated(self) -> NDArray[np.bool_]:
        """Return which ports (ports,) hold much that no path explains: a share of their power and far over the rest."""
        left, power = energy_of(self.spectrum.residual), energy_of(self.spectrum.samples)
        usual = _median(left[power > 0.0])
        return np.array((left > thresholds.SATURATED_EXCESS * usual) & (left > thresholds.SATURATED_SHARE * power))

    def result(self) -> Estimates:
        """Return what was found, sorted by distance."""
        geometry, normal, level, covariance = self.fit
        strength = np.sum(np.abs(self.spectrum.taken.on_ports) ** 2, axis=1) / self.receiver.array.ports
        order = np.argsort(geometry[:, 0], kind="stable")
        of_fitted = 10.0 * np.log10(np.maximum(strength / level, 1e-12))
        snr_db = of_fitted - 10.0 * np.log10(self.receiver.fitted.size)
        return Estimates(geometry[order], covariance[order], snr_db[order], (normal.wald / level)[order])


def _beside_stronger(fit: Fit, receiver: Receiver) -> NDArray[np.bool_]:
    """Return which paths (n,) have a stronger one within a resolution cell."""
    apart = fit.geometry[:, None] - fit.geometry[None]
    apart[..., 1] = wrap_angle(apart[..., 1])
    cell = np.array([thresholds.CELL_M * receiver.demands.coarser, thresholds.CELL_RAD, thresholds.CELL_RAD])
    weaker = fit.normal.wald[:, None] < fit.normal.wald[None, :]
    return np.asarray(((np.abs(apart) < cell).all(axis=-1) & weaker).any(axis=1), np.bool_)


def _untried() -> Trials:
    """Return room for the cells of a search: joint fits that find no more are failures, too."""
    return Trials(np.empty((thresholds.MOST_FAILURES * (thresholds.JOINT_EVERY + 1), 2), np.int64), 0, 0)
