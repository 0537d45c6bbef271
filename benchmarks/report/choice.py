"""What a report is asked to show, and how its numbers are shortened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Choice:
    """What a report shows of the worst trials: how many of each of these estimators, and by which metric.

    `estimators` empty: the one whose median is lowest, oracles aside.
    """

    worst: int = 3
    metric: str = "position_rmse_m"
    estimators: Sequence[str] = ()


def rounded(values: Any, digits: int = 2) -> Any:
    """Return an array as nested lists of short numbers, what is not finite as None."""
    array = np.asarray(values, np.float64)
    if array.ndim > 1:
        return [rounded(row, digits) for row in array]
    short = np.round(array, digits) + 0.0
    whole = digits <= 0
    return [(int(v) if whole else v) if np.isfinite(v) else None for v in short.tolist()]
