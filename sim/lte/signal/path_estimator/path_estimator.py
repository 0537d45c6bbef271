"""Path estimator of one link: search, one-path fits, joint maximum-likelihood fit, model order (RIMAX-type).

Samples y (ports x tones) of n paths at theta = (distance d, azimuth, elevation), with linear weights w_p in C^2

    model       y = A(theta) w + noise;   column (p, q) of A is b_q(az_p, el_p) (x) exp(-j 2 pi f d_p / c)
    weights     G = A^H A,  b = A^H y,  w = G^-1 b:  they are eliminated            `normal_equations`
    explained   E(theta) = b^H G^-1 b, maximised by Levenberg-Marquardt             `climb`, `joint_fit.refine`
    Jacobian    D = d(A w) / d theta,  C = D^H A
      information  J = Re(D^H D - C G^-1 C^H),   gradient  g = Re(D^H (y - A w))    `normal_equations`
      step         (J + lambda diag J) step = g                                     `climb`
    energy      W_p = w_p^H ((G^-1)_pp)^-1 w_p: what would be lost with path p      `normal_equations`
    search      the strongest cell (direction k, delay d) of the residual's energy
                that exceeds the threshold times its surroundings                   `strongest`, `local_level`
    order       p stays while W_p > threshold sigma_p^2, sigma_p^2: the
                disturbance around it, and while its deviations are small           `judged`
    covariance  sigma_p^2 (2 J)^-1                                                  `joint_fit.covariance`

Source: after Richter, "Estimation of radio channel parameters: models and algorithms", 2005: strongest path first,
joint refinement, reliability by the Fisher information; local disturbance instead of a parametric diffuse model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import CircularArray, Complex, Floats
from cellslam.sim.lte.signal.path_estimator.acquire_kernel import Rules, Trials, add_paths, taken_out
from cellslam.sim.lte.signal.path_estimator.joint_fit import FINE_GAIN, Fit, covariance, refine, steps_of
from cellslam.sim.lte.signal.path_estimator.keep_kernel import Demands, judged
from cellslam.sim.lte.signal.path_estimator.search_kernel import DIFFUSE_MARGIN, both, footprint_of
from cellslam.sim.lte.signal.path_estimator.spectrum import Spectrum
from cellslam.sim.lte.signal.receiver import DELAY_PITCH_M, HIGHEST_RAD, LOWEST_RAD, Motion, Receiver

COARSE = 0.58  # share of the threshold at which a cell is looked at: the grid loses up to 2.4 dB
_PROMISING = 0.85  # share of the threshold that the first step of a one-path fit must promise
MOST_FAILURES = 10  # cells that turn out to be noise or diffuse energy before the search ends
MOST_PATHS = 32  # of one link
JOINT_EVERY = 4  # paths found one by one before all are fitted jointly
_COARSE_GAIN = 0.2  # noise variances; the last fit is finer
# A saturated port's residual exceeds the others' by this, and is this share of its power; calibration errors leave 1 %.
_SATURATED_EXCESS, _SATURATED_SHARE = 6.0, 0.25
_FARTHEST = np.array([3.0 * DELAY_PITCH_M, np.radians(20.0)])  # that a fit may end from its cell; distances: 100 RB
_TOUCHING_M = 40.0  # within which dropping one path may save another
_UNEVEN = 0.4  # nepers of power from which the disturbance of some port differs by more than scatter
_CELL = np.array([12.0, np.radians(18.0), np.radians(18.0)])  # within which paths may stand for each other
# A path this much weaker than one within reach may be a ghost of calibration error, and must stand out farther.
_SUSPECT_SHARE, _SUSPECT_MARGIN = 0.01, 1.4
# Deviations in m, rad, rad from which a path is not reliable.
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
    """Return the paths in a link's samples (ports, tones); `start` (n, 3) in m, rad, rad: to begin with (tracking).

    Ports that deliver nothing, or nothing finite, are left out; so are saturated ones, whose samples the paths of the
    other ports do not explain. Raises InputError where no port delivers anything, and for samples of
    another shape.
    """
    expected = (motion.receiver.array.ports, len(motion.receiver.tones_hz))
    if y.shape != expected:
        raise InputError(f"samples of shape {y.shape}: {expected} (array ports, tones) are expected")
    working: NDArray[np.bool_] = np.logical_and(np.isfinite(y).all(axis=1), y.any(axis=1))
    if not working.any():
        raise InputError("no array port delivered samples: all are zero or not finite")
    y = motion.receiver.fitted.of(y)
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
        link.fit_jointly(start, FINE_GAIN)
    link.search()
    return link


def _port_weights(y: Complex, working: NDArray[np.bool_], receiver: Receiver) -> Floats:
    """Return weights (ports,) that make the disturbance alike: a port that faces an interferer counts less.

    The disturbance of a port is the median over delays, whose resolved paths are few. Ports of one column and slant
    face the same way: their mean is taken where they agree. Zero for ports out of work.
    """
    tapered = np.where(working[:, None], y, 0.0).astype(np.complex64) @ receiver.quiet_matrix
    level = _row_medians(tapered.real**2 + tapered.imag**2).astype(np.float64)
    if isinstance(receiver.array, CircularArray):
        level = _agreeing(level, working, receiver.array.rings)
    usual = float(np.median(level[working]))
    even = (np.abs(np.log(np.maximum(level[working], 1e-300) / usual)) < _UNEVEN).all()
    weight = np.ones(len(y)) if even else np.sqrt(usual / np.maximum(level, 0.1 * usual))
    return np.where(working, weight, 0.0)


def _row_medians(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median (n,) of each row of `values` (n, m); NumPy's own takes ten times as long."""
    count, ordered = values.shape[1], np.sort(values, axis=1)
    return np.asarray(0.5 * (ordered[:, (count - 1) // 2] + ordered[:, count // 2]), np.float32)


def _agreeing(level: Floats, working: NDArray[np.bool_], rings: int) -> Floats:
    """Return `level` (ports,), replaced by the mean of its column and slant where it is within a factor of two."""
    parts, counted = level.reshape(-1, rings, 2), working.reshape(-1, rings, 2)
    median = np.median(parts, axis=1, keepdims=True)
    alike = counted & (parts < 2.0 * median) & (parts > 0.5 * median)
    mean = np.sum(parts * alike, axis=1, keepdims=True) / np.maximum(np.sum(alike, axis=1, keepdims=True), 1)
    return np.asarray(np.where(alike, mean, parts).reshape(-1), np.float64)


class _Link:
    """Working state of one link and snapshot: the fit so far, the residual and its spectrum."""

    def __init__(self, y: Complex, motion: Motion) -> None:
        self.y, self.motion, self.receiver = y, motion, motion.receiver
        self.residual = y.astype(np.complex64)
        self.geometry = np.empty((0, 3))
        self.fit: Fit | None = None
        self.level, self.fine = np.empty(0), False
        self.spectrum = Spectrum(y, motion)

    def fit_jointly(self, geometry: Floats, least_gain: float = _COARSE_GAIN) -> None:
        """Refine all paths, drop what does not pass, and look at the residual again."""
        self.fit, self.geometry, self.level, self.fine = None, np.empty((0, 3)), np.empty(0), least_gain == FINE_GAIN
        while len(geometry):
            fit = refine(self.y, self.motion, geometry, self.spectrum.noise, least_gain)
            self.spectrum.leave(fit)
            level, kept = judged(
                fit.geometry, fit.normal, *self.spectrum.parts, self.motion.probe, _demands(self.receiver)
            )
            if kept.all():
                self.fit, self.geometry, self.level = fit, fit.geometry, level
                break
            geometry = fit.geometry[kept]
        if self.fit is None:
            self.spectrum.leave(None)
        self.residual = (self.y - self.fit.samples if self.fit else self.y).astype(np.complex64)

    def unite(self) -> None:
        """Drop each path that a close stronger one can stand for: a fit without it explains as much."""
        tried = 0
        while self.fit is not None and tried < len(self.geometry):
            near = _beside_stronger(self.fit, self.receiver)
            order = [i for i in np.argsort(self.fit.normal.wald) if near[i]]
            if tried >= len(order):
                return
            i = order[tried]
            rest = np.delete(self.geometry, i, axis=0)
            alone = refine(self.y, self.motion, rest, self.spectrum.noise)
            if self.fit.normal.explained - alone.normal.explained < self.receiver.threshold * self.level[i]:
                self.fit_jointly(alone.geometry, FINE_GAIN)
                tried = 0
            else:
                tried += 1

    def search(self) -> None:
        """Add paths, the strongest first, until nothing more stands out."""
        trials, most = _untried(), len(self.geometry)
        while True:
            found, trials = self._add(trials, min(JOINT_EVERY, MOST_PATHS - len(self.geometry)))
            if not len(found):
                break
            self.fit_jointly(np.concatenate([self.geometry, found]))
            if len(self.geometry) > most:
                # The joint fit has changed the residual: what was tried in vain is worth another look.
                trials, most = _untried(), len(self.geometry)
            else:
                trials = trials._replace(failures=trials.failures + 1)
        if not self.fine:
            self.fit_jointly(self.geometry, FINE_GAIN)
        self.unite()

    def _add(self, trials: Trials, most: int) -> tuple[Floats, Trials]:
        """Return up to `most` paths (n, 3) that one-path fits confirm, taken out of residual and spectrum, and what has
        been tried by then: what the joint fit drops must not come back for ever.
        """
        model, r, found = self.motion.model, self.receiver, np.empty((most, 3))
        farthest = _FARTHEST * r.coarser[[0, 2]]
        rules = Rules(
            coarse=COARSE * r.threshold, threshold=r.threshold, promising=_PROMISING, most=MOST_FAILURES,
            farthest_m=float(farthest[0]), farthest_rad=float(farthest[1]), margin=DIFFUSE_MARGIN,
            least_gain=_COARSE_GAIN,
        )  # fmt: skip
        if model is None:
            return self._add_any(trials, rules, found)
        count, trials = add_paths(
            self.residual, *self.spectrum.parts, self.motion.probe, trials, rules, steps_of(r), model, found
        )
        return found[:count], Trials(*trials)

    def _add_any(self, trials: Trials, rules: Rules, found: Floats) -> tuple[Floats, Trials]:
        """Do the same step by step, for any array."""
        cells, count, failures = trials
        s, probe, taken, added = self.spectrum, self.motion.probe, self.spectrum.taken, 0
        s.look(taken)
        while added < len(found) and failures < rules.most:
            cell = s.strongest(rules.coarse, cells[:count])
            if cell is None:
                break
            start, at, level = cell
            cells[count], count, failures = at, count + 1, failures + 1
            asked = rules.threshold * level
            samples, promising = self.residual.astype(np.complex128), rules.promising * rules.threshold
            fit = refine(samples, self.motion, start[None, :], level, rules.least_gain, promising)
            away = np.abs(fit.geometry[0] - start)[[0, 2]]
            if fit.normal.explained < asked or (away > [rules.farthest_m, rules.farthest_rad]).any():
                continue
            one = footprint_of(*fit.factors, probe)
            if taken_out(fit.geometry, fit.normal, one, *at, self.residual, s.outputs, taken, s.power, probe, rules):
                found[added], taken = fit.geometry[0], both(taken, one)
                added, failures = added + 1, failures - 1
                s.look(taken)
        return found[:added], Trials(cells, count, failures)

    def saturated(self) -> NDArray[np.bool_]:
        """Return which ports (ports,) hold much that no path explains: a share of their power and far over the rest."""
        left, power = (np.sum(x.real**2 + x.imag**2, axis=1) for x in (self.residual, self.y))
        usual = np.median(left[power > 0.0])
        return np.array((left > _SATURATED_EXCESS * usual) & (left > _SATURATED_SHARE * power), np.bool_)

    def result(self) -> Estimates:
        """Return what was found, sorted by distance."""
        if self.fit is None:
            return NOTHING
        energy = self.fit.normal.wald
        strength = np.sum(np.abs(self.fit.factors[0]) ** 2, axis=1) / len(self.y)
        order = np.argsort(self.geometry[:, 0], kind="stable")
        of_fitted = 10.0 * np.log10(np.maximum(strength / self.level, 1e-12))
        snr_db = of_fitted - 10.0 * np.log10(self.receiver.fitted.size)
        spread = covariance(self.fit, self.level)
        return Estimates(self.geometry[order], spread[order], snr_db[order], (energy / self.level)[order])


def _beside_stronger(fit: Fit, receiver: Receiver) -> NDArray[np.bool_]:
    """Return which paths (n,) have a stronger one within a resolution cell."""
    apart = fit.geometry[:, None] - fit.geometry[None]
    apart[..., 1] = wrap_angle(apart[..., 1])
    weaker = fit.normal.wald[:, None] < fit.normal.wald[None, :]
    return np.asarray(((np.abs(apart) < _CELL * receiver.coarser).all(axis=-1) & weaker).any(axis=1), np.bool_)


def _untried() -> Trials:
    """Return room for the cells of a search: joint fits that find no more are failures, too."""
    return Trials(np.empty((MOST_FAILURES * (JOINT_EVERY + 1), 2), np.int64), 0, 0)


def _demands(receiver: Receiver) -> Demands:
    """Return what the paths of a joint fit must fulfil to stay."""
    return Demands(
        threshold=receiver.threshold, suspect_share=_SUSPECT_SHARE, suspect_margin=_SUSPECT_MARGIN,
        ghost_share=10.0 ** (-receiver.ghost_rule_db / 10.0), reliable=_LEAST_RELIABLE * receiver.coarser,
        lowest=np.array([receiver.window_min_m, -np.inf, LOWEST_RAD]),
        highest=np.array([receiver.window_max_m, np.inf, HIGHEST_RAD]),
        touching_m=float(_TOUCHING_M * receiver.coarser[0]),
    )  # fmt: skip
