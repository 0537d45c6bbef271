"""Integrity: whether errors stay below the protection levels that are claimed, and which alert limits these serve.

Of a claimed covariance P and a risk, the protection level PL is what the error exceeds with that probability. With an
alert limit AL, a snapshot is

    available     PL < AL
    misleading    error > PL
    hazardous     PL < AL < error: the vehicle relies on a position that is off by more than it can bear

A drive (scenario, seed and trial) is one correlated sample, however many snapshots it has: each gives one share, and
upper limits of 95 % are over independent drives (`statistics.upper_limit`): none of 20 drives being misleading shows no
less than 14 %.

An overbound is a claim that was widened until, on training drives, errors exceed no size more often than it says, down
to the last snapshot: for the normalised squared errors q of the upper half, Pr(Q >= q) <= beyond(q). It is Student's t
with P times scale^2; of six numbers of degrees of freedom, Gaussian included, the one with the least protection level.

Sources: Tossaint et al., "The Stanford-ESA integrity diagram", J. Institute of Navigation 54(2), 2007; DeCleene,
"Defining pseudorange integrity: overbounding", ION GPS 2000; Rife et al., "Paired overbounding for nonideal LAAS and
WAAS error distributions", IEEE Trans. Aerospace and Electronic Systems 42(4), 2006.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.belief import AS_CLAIMED, Claim
from cellslam.benchmarks.scores.metrics import ALERT_LIMIT_M, NO_ERRORS, RISK, Errors
from cellslam.benchmarks.scores.statistics import upper_limit
from cellslam.benchmarks.sweeps.store import trajectory_of
from cellslam.benchmarks.tables.summaries import CONFIDENCE, Layout, groups, ok_rows, row_keys
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    import pandas as pd

DIRECTIONS = ("horizontal", "along", "across")
FREEDOMS = (math.inf, 30.0, 10.0, 5.0, 3.0, 2.0)
UPPER_HALF, SERVED = 0.5, 0.99
DRIVE = ("scenario", "seed", "trial")
Drive = tuple[Any, ...]


@dataclass(frozen=True)
class Question:
    """What is asked of an estimator: risk, alert limits in m, and the direction of the error."""

    risk: float = RISK
    alert_limits_m: Sequence[float] = (ALERT_LIMIT_M,)
    direction: str = "horizontal"

    def __post_init__(self) -> None:
        if not 0.0 < self.risk < 0.5:
            raise InputError(f"risk = {self.risk:g}: must be above 0 and below 0.5")
        if not all(limit > 0.0 and math.isfinite(limit) for limit in self.alert_limits_m):
            raise InputError("an alert limit must be above 0 m")


@dataclass(frozen=True)
class Overbound:
    """Claims by estimator, with the `drives` that they were fitted on, of these `seeds`."""

    claims: Mapping[str, Claim]
    seeds: tuple[int, ...]
    drives: int

    def text(self) -> str:
        """Return the overbound as JSON; infinite degrees of freedom, Gaussian, are null."""
        claims = {
            name: {"scale": one.scale, "freedom": None if math.isinf(one.freedom) else one.freedom}
            for name, one in self.claims.items()
        }
        return json.dumps({"estimators": claims, "seeds": self.seeds, "drives": self.drives}, indent=1) + "\n"

    @classmethod
    def load(cls, path: Path) -> Overbound:
        """Return the overbound of a file. Raises InputError."""
        try:
            held = json.loads(path.read_text("utf-8"))
            claims = {
                str(name): Claim(float(one["scale"]), math.inf if one["freedom"] is None else float(one["freedom"]))
                for name, one in held["estimators"].items()
            }
            if not all(0.0 < one.scale < math.inf and one.freedom >= 1.0 for one in claims.values()):
                raise ValueError("a scale or a number of degrees of freedom is out of range")
            return cls(claims, tuple(int(seed) for seed in held["seeds"]), int(held["drives"]))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: not a file of fit-overbound ({' '.join(str(error).split())})") from error


def integrity(
    folder: str | Path, question: Question | None = None, overbound: Overbound | None = None,
    rows: Sequence[str] | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Return the integrity of estimators, by group of a sweep's drives, alert limit, and way to read the claims.

    Columns: the row keys, `claims` (as claimed, overbound), `alert_limit_m`, `drives`; `protection_m`, the median
    protection level, `served_m`, the least alert limit that is available in 99 % of the snapshots; shares of snapshots
    `availability`, `misleading` and `hazardous`, the last two with upper 95 % limits over drives (`_high`). Raises
    InputError, also where an overbound was fitted on drives of the same seed.
    """
    import pandas as pd

    question = question or Question()
    keys = row_keys(folder, Layout(rows=rows))
    lines = []
    for values, group in groups(ok_rows(folder, [*keys, "estimator", *DRIVE]), keys):
        names = set(group["estimator"])
        kept = _errors(Path(folder), group)
        if not kept:
            continue
        ways = {"as claimed": AS_CLAIMED}
        if overbound is not None and len(names) == 1 and (name := names.pop()) in overbound.claims:
            if shared := sorted(set(group["seed"]) & set(overbound.seeds)):
                raise InputError(f"the overbound was fitted on drives of seed {shared[0]}: test it on other seeds")
            ways["overbound"] = overbound.claims[name]
        for way, claim in ways.items():
            pairs = [(drive, *one.protection(question.direction, claim, question.risk)) for drive, one in kept]
            lines += [{**values, "claims": way, **_line(pairs, limit)} for limit in question.alert_limits_m]
    if not lines:
        raise InputError(f"{folder}: no covariances are kept: sweep again, with this version and trajectories")
    return pd.DataFrame(lines)


def fit_overbound(folder: str | Path, risk: float = RISK) -> Overbound:
    """Return the overbound of each estimator over all drives of a sweep. Raises InputError."""
    Question(risk)
    frame = ok_rows(folder, ["estimator", *DRIVE])
    claims = {}
    for values, group in groups(frame, ["estimator"]):
        squared = [one.squared[np.isfinite(one.squared)] for _, one in _errors(Path(folder), group)]
        if squared:
            claims[str(values["estimator"])] = fitted(squared, risk)
    if not claims:
        raise InputError(f"{folder}: no covariances are kept: sweep again, with this version and trajectories")
    drives = len(frame.drop_duplicates(list(DRIVE)))
    return Overbound(claims, tuple(sorted({int(seed) for seed in frame["seed"]})), drives)


def fitted(drives: Sequence[Floats], risk: float) -> Claim:
    """Return the overbound of normalised squared errors, (n,) of each drive; drives weigh alike."""
    squared = np.concatenate(drives)
    weight = np.concatenate([np.full(len(one), 1.0 / (len(one) * len(drives))) for one in drives])
    order = np.argsort(squared)[::-1]
    reached = np.cumsum(weight[order])  # Pr(Q >= q)
    upper = reached <= UPPER_HALF
    q, p = squared[order][upper], reached[upper]
    if not len(q) or q[0] <= 0.0:
        return AS_CLAIMED
    claims = [Claim(math.sqrt(float(np.max(q / _reach(p, freedom)))), freedom) for freedom in FREEDOMS]
    return min(claims, key=lambda one: one.scale**2 * float(_reach(np.array([risk]), one.freedom)[0]))


def regions(error: Floats, level: Floats, alert_limit_m: float) -> dict[str, float]:
    """Return the shares of errors (n,) and protection levels (n,) in m by region of the Stanford diagram."""
    available, misled = level < alert_limit_m, error > level
    hazardous = available & (error > alert_limit_m)
    return {
        "nominal": float(np.mean(available & ~misled)),
        "misleading": float(np.mean(available & misled & ~hazardous)),
        "hazardous": float(np.mean(hazardous)),
        "unavailable": float(np.mean(~available & ~misled)),
        "unavailable, misleading": float(np.mean(~available & misled)),
    }


def _reach(p: Floats, freedom: float) -> Floats:
    """Return the squared error (n,) that is exceeded with probability p (n,): the inverse of `Claim.beyond`."""
    return np.asarray(-2.0 * np.log(p) if math.isinf(freedom) else freedom * (p ** (-2.0 / freedom) - 1.0))


def _errors(folder: Path, rows: pd.DataFrame) -> list[tuple[Drive, Errors]]:
    """Return the errors of rows with claims, and of which drive each is."""
    out = []
    for drive, key in zip(rows[list(DRIVE)].itertuples(index=False, name=None), rows["key"], strict=True):
        kept = trajectory_of(folder, key)
        errors = NO_ERRORS if kept is None else kept.errors
        if np.isfinite(errors.squared).any():
            out.append((drive, errors))
    return out


def _by_drive(shares: Iterable[tuple[Drive, float]]) -> Floats:
    """Return the shares (n,) of drives: rows of one drive, under other settings, are no drives of their own."""
    found: dict[Drive, list[float]] = {}
    for drive, share in shares:
        found.setdefault(drive, []).append(share)
    return np.array([np.mean(own) for own in found.values()])


def _line(pairs: Sequence[tuple[Drive, Floats, Floats]], limit: float) -> dict[str, Any]:
    levels = np.concatenate([level for _, _, level in pairs])
    misleading = _by_drive((drive, float(np.mean(error > level))) for drive, error, level in pairs)
    hazardous = _by_drive((drive, regions(error, level, limit)["hazardous"]) for drive, error, level in pairs)
    return {
        "alert_limit_m": limit, "drives": len(misleading), "protection_m": float(np.median(levels)),
        "served_m": float(np.quantile(levels, SERVED)), "availability": float(np.mean(levels < limit)),
        "misleading": float(misleading.mean()), "misleading_high": upper_limit(misleading, CONFIDENCE),
        "hazardous": float(hazardous.mean()), "hazardous_high": upper_limit(hazardous, CONFIDENCE),
    }  # fmt: skip
