"""GOSPA: one distance between a set of true and a set of estimated positions, and its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from cellslam.sim.recording import Floats, Ints

ALPHA = 2.0


@dataclass(frozen=True)
class Gospa:
    """A GOSPA and how it arises: pairs matched within the cut-off, truths missed, false estimates; which `pairs`
    (matched, 2) of truth and estimate were matched."""

    distance_m: float
    localisation_rmse_m: float
    matched: int
    missed: int
    false: int
    pairs: Ints


def gospa(truth_m: ArrayLike, estimate_m: ArrayLike, cutoff_m: float = 20.0, order: float = 2.0) -> Gospa:
    """Return the GOSPA (alpha = 2) between positions (n, d) and (k, d) in metres, either possibly empty.

    The best assignment minimises sum d^p over pairs nearer than `cutoff_m` plus cutoff^p / 2 for each truth
    without an estimate and each estimate without a truth; the distance is the p-th root. Source:
    Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment metric", FUSION
    2017, proposition 1.
    """
    truth, estimate = np.asarray(truth_m, np.float64), np.asarray(estimate_m, np.float64)
    if not len(truth) or not len(estimate):
        return gospa_of(np.zeros((len(truth), len(estimate))), cutoff_m, order)
    return gospa_of(np.linalg.norm(truth[:, None, :] - estimate[None, :, :], axis=-1), cutoff_m, order)


def gospa_of(distance_m: Floats, cutoff_m: float = 20.0, order: float = 2.0) -> Gospa:
    """Return the GOSPA between n truths and k estimates that are at these distances (n, k) in m, as `gospa` does."""
    rows, columns = linear_sum_assignment(np.minimum(distance_m, cutoff_m) ** order)
    inside = distance_m[rows, columns] < cutoff_m
    rows, columns = rows[inside], columns[inside]
    near = distance_m[rows, columns]
    missed, false = distance_m.shape[0] - len(near), distance_m.shape[1] - len(near)
    cost = float((near**order).sum()) + cutoff_m**order / ALPHA * (missed + false)
    rmse = float(np.sqrt((near**2).mean())) if len(near) else float("nan")
    return Gospa(cost ** (1.0 / order), rmse, len(near), missed, false, np.column_stack([rows, columns]))
