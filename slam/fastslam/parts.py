"""The parts of FastSLAM that can be replaced: what each is given, what it returns, and those that are built in.

A part is a plain function (or an object that can be called) over NumPy arrays. Where there is an axis of particles, N,
it is the last one. Parts are called for each group of particles by itself.

    slot         when it is called              it is given                           it returns
    association  a snapshot, again at a step    Candidates                            candidates (H, m)
    birth        after that                     Candidates, candidate_of (m,)         who begins a VT (m,)
    proposal     a block of snapshots           mean (d, N), covariance (d, d), rng   draws (d, N), log ratio (N,)
    update       a block                        G (k, n), W (k, N)                    G, W: M += G^T W, P -= G^T G
    weight       a block                        W (k, N)                              log-likelihood (N,)
    pruning      a block                        Transmitters                          who is dropped (V,)
    resampling   when weights are unequal       weights (N,), count, rng              ancestors (count,)

A step is one of a clock, which is found by the associations and undone before they are made again. Resampling is also
called when the number of groups changes: count, the new share of a group, then differs from N.
The letters are those of `fastslam.py`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from inspect import signature
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cellslam.sim.errors import InputError, one_line, unknown_name
from cellslam.sim.own_code import seek_here
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.resampling import SCHEMES

Bools = NDArray[np.bool_]
NO_VT = -1  # a measurement of no candidate
RIVAL = 4.0  # log-likelihood that a second hypothesis may lose against the best one
INFLUENCE = 3.0  # whitened innovation of a particle from which on it counts for less


@dataclass(frozen=True)
class Candidates:
    """The m measurements of a snapshot beside V virtual transmitters (VTs) that may have caused them.

    `log_ratio` (V, m): how much likelier it is that the VT was detected as this measurement than that it was missed
    and the measurement is clutter, log p_D N(e; 0, S) / (lambda_c (1 - p_D)); -inf outside the gate, and where VT and
    measurement are of different base stations or ports. `distance2` (V, m): e^T S^-1 e, squared Mahalanobis distance
    of the innovation e; inf where log_ratio is -inf. S holds the covariance of state and measurement, and that of the
    particles. `detections` (V,): how often each VT was detected so far.
    """

    log_ratio: Floats
    distance2: Floats
    detections: Ints


@dataclass(frozen=True)
class Transmitters:
    """The V virtual transmitters of a group: `detections` (V,), the time `unseen_s` (V,) since the last one, and
    `lifetime_s` (V,), after which one that was never confirmed is unlikely to exist; `confirmed` (V,)."""

    detections: Ints
    unseen_s: Floats
    lifetime_s: Floats
    confirmed: Bools


Association = Callable[[Candidates], Ints]
Birth = Callable[[Candidates, Ints], Bools]
Proposal = Callable[[Floats, Floats, np.random.Generator], tuple[Floats, Floats]]
Update = Callable[[Floats, Floats], tuple[Floats, Floats]]
Weight = Callable[[Floats], Floats]
Pruning = Callable[[Transmitters], Bools]
Resampling = Callable[[Floats, int, np.random.Generator], Ints]


# Association: rows of hypotheses, the likeliest first; in each, the candidate of every measurement, NO_VT for none.


def maximum_likelihood(candidates: Candidates) -> Ints:
    """Return the assignment (1, m) with the greatest sum of log-ratios, by the Jonker-Volgenant algorithm.

    Source: Blackman and Popoli, "Design and analysis of modern tracking systems", 1999, chapter 6.
    """
    return _assigned(np.maximum(candidates.log_ratio, 0.0))[None]


def nearest_neighbour(candidates: Candidates) -> Ints:
    """Return an assignment (1, m): the pair with the least Mahalanobis distance first, then the next of those left.

    Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001.
    """
    left, chosen = candidates.distance2.copy(), np.full(candidates.distance2.shape[1], NO_VT)
    while left.size and np.isfinite(least := left.min()):
        v, k = np.argwhere(left == least)[0]
        chosen[k] = v
        left[v], left[:, k] = np.inf, np.inf
    return chosen[None]


def hypotheses(candidates: Candidates) -> Ints:
    """Return the best assignment and, where it is nearly as likely, the second best: (1, m) or (2, m).

    The group of particles then goes on as two. Sources: Murty, "An algorithm for ranking all the assignments in order
    of increasing cost", Operations Research 16(3), 1968; Reid, "An algorithm for tracking multiple targets", IEEE
    Trans. Automatic Control 24(6), 1979.
    """
    score = np.maximum(candidates.log_ratio, 0.0)
    best = _assigned(score)
    columns = np.flatnonzero(best >= 0)
    value, second, second_value = score[best[columns], columns].sum(), None, -math.inf
    for k in columns:  # the best assignment without one of its pairs
        without = score.copy()
        without[best[k], k] = 0.0
        other = _assigned(without)
        pairs = np.flatnonzero(other >= 0)
        if (found := without[other[pairs], pairs].sum()) > second_value:
            second, second_value = other, found
    return best[None] if second is None or value - second_value > RIVAL else np.stack([best, second])


def _assigned(score: Floats) -> Ints:
    """Return the candidate (m,) of each measurement in the assignment with the greatest sum of scores (V, m) > 0."""
    chosen = np.full(score.shape[1], NO_VT)
    rows, columns = linear_sum_assignment(score, maximize=True)
    positive = score[rows, columns] > 0.0
    chosen[columns[positive]] = rows[positive]
    return chosen


# Birth: which of the measurements without a VT begin one.


def outside_gates(candidates: Candidates, candidate_of: Ints) -> Bools:
    """Return the measurements (m,) in nobody's gate: what lies near a VT is taken for another measurement of this
    one."""
    return (candidate_of < 0) & ~np.isfinite(candidates.distance2).any(axis=0)


def unassigned(candidates: Candidates, candidate_of: Ints) -> Bools:
    """Return all measurements (m,) without a VT, as in the paper, section IV."""
    del candidates
    return candidate_of < 0


# Proposal: draws of the odometry's white noise, summed up over a block, and the log of target over proposal density.


def gaussian(mean: Floats, covariance: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return independent draws (d, N) of N(mean (d, N), covariance (d, d)): the exact posterior, ratio one."""
    return mean + _root(covariance) @ rng.standard_normal(mean.shape), np.zeros(mean.shape[1])


def antithetic(mean: Floats, covariance: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return draws as `gaussian`, in pairs of opposite ones: their mean over the particles errs less.

    Source: Hammersley and Morton, "A new Monte Carlo technique: antithetic variates", Proc. Cambridge Philosophical
    Society 52(3), 1956.
    """
    d, N = mean.shape
    half = rng.standard_normal((d, (N + 1) // 2))
    return mean + _root(covariance) @ np.concatenate([half, -half], axis=1)[:, :N], np.zeros(N)


def _root(covariance: Floats) -> Floats:
    """Return a root A, A A^T = covariance (d, d), which may be singular."""
    value, vector = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))


# Update: of k innovations, with L L^T = S = H P H^T + R, whitened innovations W = L^-1 E and gains G = L^-1 H P.


def kalman(G: Floats, W: Floats) -> tuple[Floats, Floats]:
    """Return G (k, n) and W (k, N) as they are: M + K E = M + G^T W, P - K S K^T = P - G^T G with K = P H^T S^-1.

    Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, ch. 5.2.
    """
    return G, W


def bounded(G: Floats, W: Floats) -> tuple[Floats, Floats]:
    """Return the update with innovations that are clipped, particle by particle, at three deviations.

    Source: Huber, "Robust statistics", 1981, section 7.
    """
    return G, np.clip(W, -INFLUENCE, INFLUENCE)


# Weight: log-likelihood of each particle, up to what is common to all.


def likelihood(W: Floats) -> Floats:
    """Return log N(e; 0, S) (N,) but for log det S, which all particles of a group have in common."""
    return np.asarray(-0.5 * np.einsum("kn,kn->n", W, W))


@dataclass(frozen=True)
class Tempered:
    """The likelihood to a power below one: what the model leaves out makes it too sure.

    Source: Del Moral, Doucet and Jasra, "Sequential Monte Carlo samplers", J. R. Statist. Soc. B 68(3), 2006.
    """

    power: float = 0.5

    def __call__(self, W: Floats) -> Floats:
        """Return the log-likelihood (N,) times the power."""
        return self.power * likelihood(W)


# Pruning: which VTs are dropped.


def unlikely(vts: Transmitters) -> Bools:
    """Return those (V,) that were not confirmed, and not seen again for longer than one that exists would be."""
    return ~vts.confirmed & (vts.unseen_s > vts.lifetime_s)


def never(vts: Transmitters) -> Bools:
    """Return none (V,): the filter keeps every VT until its memory is full."""
    return np.zeros(len(vts.detections), np.bool_)


class Parts(NamedTuple):
    """One part for each slot."""

    association: Association = maximum_likelihood
    birth: Birth = outside_gates
    proposal: Proposal = gaussian
    update: Update = kalman
    weight: Weight = likelihood
    pruning: Pruning = unlikely
    resampling: Resampling = SCHEMES["systematic"]


# The names of the built-in parts, by slot; the default first.
BUILT_IN: Mapping[str, Mapping[str, Callable[..., Any]]] = {
    "association": {
        "maximum-likelihood": maximum_likelihood, "nearest-neighbour": nearest_neighbour, "hypotheses": hypotheses,
    },
    "birth": {"outside-gates": outside_gates, "unassigned": unassigned},
    "proposal": {"gaussian": gaussian, "antithetic": antithetic},
    "update": {"kalman": kalman, "bounded": bounded},
    "weight": {"likelihood": likelihood, "tempered": Tempered()},
    "pruning": {"unlikely": unlikely, "never": never},
    "resampling": SCHEMES,
}  # fmt: skip


# What a part that is never called was waiting for, in a drive in which others were called.
NO_BLOCK = "no block of snapshots ended; 'block_s' says how long one is"
WAITS_FOR = {
    "association": "there was no VT yet",
    "birth": "there was no measurement",
    "proposal": "nothing was drawn; 'lag' says when it is",
    "update": NO_BLOCK,
    "weight": NO_BLOCK,
    "pruning": NO_BLOCK,
    "resampling": "weights were never unequal enough; 'effective_share' says how unequal they must be",
}


class CalledPart:
    """A part in its slot during a drive: it counts how often it is called, and an error inside it says which part it
    is."""

    def __init__(self, slot: str, part: Callable[..., Any]) -> None:
        """Take the slot and the part."""
        self.slot, self.part, self.times = slot, part, 0

    def __call__(self, *given: Any) -> Any:
        """Return what the part returns."""
        self.times += 1
        try:
            return self.part(*given)
        except Exception as error:
            error.add_note(f"in the {self.slot} {self.name}")
            raise

    @property
    def name(self) -> str:
        """What the part is called, as module:name."""
        named = self.part if hasattr(self.part, "__qualname__") else type(self.part)
        return f"{named.__module__}:{named.__qualname__}"


def never_called(parts: Sequence[Any]) -> list[str]:
    """Return a remark for each part that is not the default one and was never called, whether others were or not."""
    left = [one for one in parts if one.part is not getattr(Parts(), one.slot) and not one.times]
    if left and not any(one.times for one in parts):
        slots = ", ".join(one.slot for one in left)
        return [f"{slots}: never called: particles are drawn once clock offsets are resolved, and none was"]
    return [f"{one.slot}: {one.name} was never called, while others were: {WAITS_FOR[one.slot]}" for one in left]


KINDS = {"f": "numbers", "i": "whole numbers", "b": "true or false"}  # of what parts return, by NumPy's letters


def returned(
    slot: str, value: Any, shape: tuple[int, ...], kind: str = "f", least: int = NO_VT, below: int | None = None
) -> NDArray[Any]:
    """Return what a part has returned, as an array of this shape: of a kind in `KINDS`, and whole numbers from `least`
    on, less than `below`.

    Raises InputError, which names the slot, for anything else, NaN among it.
    """
    array = np.asarray(value)
    if array.size and (array.dtype.kind not in {"f": "fiu", "i": "iu", "b": "b"}[kind]):
        raise InputError(f"{slot}: the part returned {array.dtype} ({one_line(value)}), where {KINDS[kind]} are needed")
    if array.shape != shape:
        raise InputError(f"{slot}: the part returned an array of shape {array.shape}, where {shape} is needed")
    if kind == "f" and np.isnan(array).any():
        raise InputError(f"{slot}: the part returned NaN, where numbers are needed")
    if below is not None and array.size and (array.min() < least or array.max() >= below):
        raise InputError(
            f"{slot}: the part returned the numbers {array.min()} to {array.max()}, where {least} to {below - 1} may be"
        )
    return array


def one_to_one(candidate_of: Ints) -> Ints:
    """Return associations (H, m). Raises InputError where one of them gives a candidate two measurements."""
    for row in candidate_of:
        given = np.sort(row[row >= 0])
        if (repeated := given[1:][given[1:] == given[:-1]]).size:
            raise InputError(f"association: the part gave candidate {repeated[0]} two measurements, where one may be")
    return candidate_of


def part_named(slot: str, name: str) -> Callable[..., Any]:
    """Return a part by name: a built-in one, or an object of a module, `module:name`, also of the current directory.

    Raises InputError for an unknown name, a module that cannot be imported, and what cannot be called.
    """
    if name in BUILT_IN[slot]:
        return BUILT_IN[slot][name]
    if ":" not in name:
        raise InputError(f"{unknown_name(slot, name, BUILT_IN[slot])}; or your own part as module:name")
    module, _, attribute = name.partition(":")
    seek_here()
    try:
        found = vars(importlib.import_module(module))
    except Exception as error:
        raise InputError(f"{slot} '{name}' cannot be imported: {type(error).__name__}: {one_line(error)}") from error
    if attribute not in found:
        raise unknown_name(f"part in module {module}", attribute, [n for n, v in found.items() if callable(v)])
    return checked(slot, found[attribute])


def checked(slot: str, part: Any) -> Callable[..., Any]:
    """Return a part that is given as an object, a class as an object of it.

    Raises InputError for an unknown slot, and what cannot be called with what the slot gives.
    """
    if slot not in BUILT_IN:
        raise unknown_name("part of FastSLAM", slot, BUILT_IN)
    given = list(signature(next(iter(BUILT_IN[slot].values()))).parameters)
    try:
        made = part() if isinstance(part, type) else part
        with suppress(ValueError):  # some compiled functions do not say what they take
            signature(made).bind(*given)
    except TypeError as error:
        raise InputError(
            f"{slot}: {part!r} cannot be called with ({', '.join(given)}): {one_line(error)}; give a function of "
            "these, an object, or a class that needs no arguments (a name is for the option)"
        ) from error
    return made  # type: ignore[no-any-return]
