"""`python -m tools calibrate --check`: the two front ends in scenes that no calibration has seen.

Source: own derivation, studies/front-end-calibration.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats
from tools.calibration.scenes import Sample, config_of, measured_by_signals, measured_by_statistics, scenes_of

DRAWS = 4  # of the statistical front end, which is cheap: what scatters is the signal level then
EDGES_DB = (20.0, 27.0, 34.0, 41.0, 49.0)  # between the bins of integrated SNR
# Clutter within this of a path (m, rad) belongs to it; the rest is noise.
AHEAD_M, BEHIND_M, BESIDE_RAD = 15.0, 180.0, np.radians(75.0)
_DEGREES = np.array([1.0, 180.0 / np.pi, 180.0 / np.pi])


class Figure(NamedTuple):
    """One figure of both front ends, of `number` things; `limit` is a share of the signal level's, or `absolute`."""

    name: str
    signal: float
    statistical: float
    limit: float
    absolute: bool
    number: int

    @property
    def difference(self) -> float:
        """Return by how much the statistical front end is above, relative or absolute as the limit is."""
        apart = self.statistical - self.signal
        return apart if self.absolute else apart / max(abs(self.signal), 1e-12)

    @property
    def inside(self) -> bool:
        """Return whether the difference is within the limit."""
        return abs(self.difference) <= self.limit


def agreement(radio: RadioConfig, count: int, seed: int, ratio_db: float, progress: Progress) -> list[Figure]:
    """Return how the two front ends compare over `count` scenes, drawn from a stream of their own."""
    rng = np.random.default_rng([seed, 3, round(10.0 * ratio_db)])
    config = config_of(ratio_db, radio)
    scenes = scenes_of(rng, count, config)
    with progress(f"measuring scenes at {ratio_db:g} dB", count) as advance:
        signal = measured_by_signals(config, scenes, rng, advance)
    drawn = [measured_by_statistics(config, scenes, rng) for _ in range(DRAWS)]
    return compared([signal], drawn)


def compared(signal: list[Sample], drawn: list[Sample]) -> list[Figure]:
    """Return the figures of both front ends in the same scenes."""
    one, other = summary(signal), summary(drawn)
    return [Figure(name, value, other[name][0], *_limit(name), count) for name, (value, count) in one.items()]


def _limit(name: str) -> tuple[float, bool]:
    if name.startswith("detected"):
        return 0.05, True
    return (0.03, False) if name.startswith("reported") else (0.15, False)


def summary(samples: list[Sample]) -> dict[str, tuple[float, int]]:
    """Return each figure of one front end, and of how many it is: paths reported per link, detection probability per
    bin, deviations of the errors (beyond four robust ones, it is another path), clutter per link and its spread.
    """
    links = sum(s.links for s in samples)
    gamma, found = (np.concatenate([getattr(s, n) for s in samples]) for n in ("gamma_db", "detected"))
    error = np.concatenate([s.error[s.detected] for s in samples]) * _DEGREES
    late, beside, own = (np.concatenate(parts) for parts in zip(*(offsets(s) for s in samples), strict=True))
    out = {"reported per link": (float(found.sum() + len(late)) / links, links)}
    which = np.digitize(gamma, EDGES_DB)
    for b in range(len(EDGES_DB) + 1):
        low, high = (f"{EDGES_DB[i]:g}" if 0 <= i < len(EDGES_DB) else "" for i in (b - 1, b))
        inside = which == b
        if inside.any():
            out[f"detected, Gamma {low}..{high} dB"] = float(found[inside].mean()), int(inside.sum())
    for c, name in enumerate(("distance, m", "azimuth, deg", "elevation, deg")):
        spread = np.median(np.abs(error[:, c])) / 0.6745
        kept = error[np.abs(error[:, c]) < 4.0 * spread, c]
        out[f"error of {name}"] = float(np.sqrt(np.mean(kept**2))), len(kept)
    out["clutter per link"] = len(late) / links, len(late)
    out["clutter around paths per link"] = float(own.sum()) / links, int(own.sum())
    out["its spread in delay, m"] = float(np.std(late[own])), int(own.sum())
    out["its spread in azimuth, deg"] = float(np.degrees(np.sqrt(np.mean(beside[own] ** 2)))), int(own.sum())
    return out


def offsets(sample: Sample) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return of each clutter point (C,) by how many m it is later than the nearest path before it, how many rad beside
    it in azimuth, and whether it belongs to that path.
    """
    late, beside = np.empty(len(sample.clutter)), np.empty(len(sample.clutter))
    for i, (link, distance, azimuth, *_) in enumerate(sample.clutter):
        rows = np.flatnonzero(sample.link == int(link))
        behind = distance - sample.geometry[rows, 0]
        turn = np.abs(np.asarray(wrap_angle(azimuth - sample.geometry[rows, 1])))
        cost = np.abs(behind) / 40.0 + turn / 0.3 + np.where(behind < -AHEAD_M, 1e3, 0.0)
        nearest = int(np.argmin(cost))
        late[i], beside[i] = behind[nearest], turn[nearest]
    return late, beside, (late > -AHEAD_M) & (late < BEHIND_M) & (beside < BESIDE_RAD)


def records(figures: list[Figure]) -> list[dict[str, Any]]:
    """Return the figures as they are written to a file."""
    return [f._asdict() | {"difference": f.difference, "inside": f.inside} for f in figures]


__all__ = ["Figure", "agreement", "compared", "records", "summary"]
