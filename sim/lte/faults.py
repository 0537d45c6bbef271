"""What goes wrong over a drive: clocks that wander and step, reports that come late or twice.

A site's offset grows by its rate; both walk. In relative frequency the Allan deviation of that is

    sigma_y^2(tau) = q1 / tau + q2 tau / 3,    q1 = h_0 / 2,    q2 = 2 pi^2 h_-2

Flicker noise of the frequency, which lies between the two, is left out, as is usual in a filter's clock model.

Source: Brown and Hwang, "Introduction to random signals and applied Kalman filtering", 4th ed., 2012, section 9.3; of
reports: own model, of independent faults of single reports.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.recording import ClockSteps, Floats, Ints

if TYPE_CHECKING:
    from cellslam.sim.lte.statistical.statistical_front_end import Detections

# h_0 in s and h_-2 in 1/s of the source's table.
OSCILLATORS = {"tcxo": (2e-19, 2e-20), "ocxo": (2e-25, 6e-25), "rubidium": (2e-22, 1e-30)}


@dataclass(frozen=True)
class ClockErrors:
    """What the clocks of S sites do beside offset and constant rate, in T snapshots: `wander_m` (T, S), what their walk
    and steps have added since the first snapshot, and the `steps`, which are in it."""

    wander_m: Floats
    steps: ClockSteps


def walk_densities(oscillator: str) -> tuple[float, float]:
    """Return the densities of the walks of offset, m/sqrt(s), and rate, (m/s)/sqrt(s), of a named oscillator."""
    h0, h2 = OSCILLATORS.get(oscillator, (0.0, 0.0))
    return SPEED_OF_LIGHT_MPS * float(np.sqrt(h0 / 2.0)), SPEED_OF_LIGHT_MPS * float(np.pi * np.sqrt(2.0 * h2))


def draw_clock_errors(
    config: RadioConfig, elapsed_s: Floats, sites: int, rng: np.random.Generator
) -> ClockErrors | None:
    """Draw what the clocks of so many sites do at times elapsed_s (T,) since the first snapshot, in s.

    None: clocks run at constant rates.
    """
    if config.clock_oscillator == "ideal" and not config.clock_step_times_s and config.clock_steps_per_hour == 0.0:
        return None
    steps = _draw_steps(config, float(elapsed_s[-1]), sites, rng)
    wander_m = _walk(config.clock_oscillator, np.diff(elapsed_s), sites, rng)
    for site, time_s, size_m in zip(steps.site, steps.time_s, steps.size_m, strict=True):
        wander_m[elapsed_s >= time_s, site] += size_m
    return ClockErrors(wander_m, steps)


def _walk(oscillator: str, dt_s: Floats, sites: int, rng: np.random.Generator) -> Floats:
    """Return the walks (T, sites) in m: the exact discrete form of both, whose noises are correlated over an
    interval."""
    walk, rate_walk = walk_densities(oscillator)
    one, two, root = (*rng.standard_normal((2, len(dt_s), sites)), np.sqrt(dt_s)[:, None])
    rate = np.concatenate([np.zeros((1, sites)), np.cumsum(rate_walk * root * two, axis=0)])
    within = rate_walk * dt_s[:, None] * root * (0.5 * two + rng.standard_normal(two.shape) / np.sqrt(12.0))
    added = walk * root * one + rate[:-1] * dt_s[:, None] + within
    return np.concatenate([np.zeros((1, sites)), np.cumsum(added, axis=0)])


def _draw_steps(config: RadioConfig, duration_s: float, sites: int, rng: np.random.Generator) -> ClockSteps:
    """Return the steps of a drive in order of time: at the given times, and others as a Poisson process."""
    together = config.clock_steps_together
    times, of_site = [], []
    for row in range(1 if together else sites):
        drawn = rng.uniform(0.0, duration_s, rng.poisson(config.clock_steps_per_hour * duration_s / 3600.0))
        times.append(np.concatenate([np.array(config.clock_step_times_s, np.float64), drawn]))
        of_site.append(np.full(len(times[-1]), row))
    time_s, site = np.concatenate(times), np.concatenate(of_site)
    size_m = config.clock_step_std_m * rng.standard_normal(len(time_s))
    if together:
        time_s, size_m, site = np.repeat(time_s, sites), np.repeat(size_m, sites), np.tile(np.arange(sites), len(site))
    order = np.argsort(time_s, kind="stable")
    within = order[time_s[order] <= duration_s]
    return ClockSteps(site[within].astype(np.int64), time_s[within], size_m[within])


class Reports(NamedTuple):
    """Of T snapshots: the snapshot whose report each one has, `source` (T,), and by how much the stamp of its own
    report is late, `late_s` (T,) in s."""

    source: Ints
    late_s: Floats

    def age_s(self, time_s: Floats) -> Floats:
        """Return how much older than their stamps time_s (T,) the measurements are, (T,) in s."""
        return np.asarray(time_s - time_s[self.source] + self.late_s[self.source])


def draw_reports(config: RadioConfig, count: int, rng: np.random.Generator) -> Reports | None:
    """Draw how the reports of so many snapshots come; None: each in time, and once."""
    if config.late_probability == 0.0 and config.repeat_probability == 0.0:
        return None
    late, repeated = rng.random((2, count)) < np.array([[config.late_probability], [config.repeat_probability]])
    repeated[0], snapshot = False, np.arange(count)
    return Reports(np.maximum.accumulate(np.where(repeated, 0, snapshot)), config.late_s * late)


def poses_before(poses: Floats, time_s: Floats, late_s: Floats) -> Floats:
    """Return poses (T, 6) of a drive, in m and rad, so long (T,) before its snapshots, in s."""
    late = late_s > 0.0
    out = poses.copy()
    for c in range(6):
        column = np.unwrap(poses[:, c]) if c >= 3 else poses[:, c]
        out[late, c] = np.interp((time_s - late_s)[late], time_s, column)
    return out


def as_reported(found: Detections, reports: Reports) -> Detections:
    """Return detections in which some snapshots have those of another one once more."""
    m = found.measurements
    first = np.searchsorted(m.snapshot, np.arange(len(reports.source) + 1))
    count = np.diff(first)[reports.source]
    begin = first[reports.source] - np.concatenate([[0], np.cumsum(count)[:-1]])
    rows = np.repeat(begin, count) + np.arange(count.sum())
    columns: dict[str, Any] = {name: None if c is None else c[rows] for name, c in vars(m).items()}
    columns["snapshot"] = np.repeat(np.arange(len(count)), count)
    own: dict[str, Any] = {name: column[rows] for name, column in vars(found).items() if name != "measurements"}
    return replace(found, measurements=replace(m, **columns), **own)
