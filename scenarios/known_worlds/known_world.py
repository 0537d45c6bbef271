"""What a known world is: how a run of it is made, who meets it, what was published, and what differs here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cellslam.sim.city import City
from cellslam.sim.recording import Floats, Ints, Links, Measurements, Recording, Truth, VirtualTransmitters
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS

# Every error is white, and nothing moves the array but the vehicle.
WHITE = NOTHING_PERSISTS | {
    "noise_unit_snr_m": 0.0, "noise_unit_snr_azimuth_deg": 0.0, "noise_unit_snr_elevation_deg": 0.0,
    "misfit_scale_s": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0,
}  # fmt: skip
# In a plane an elevation of zero counts as measured, with this deviation: densities have its factor.
LEVEL_DEG = 0.3
LEVEL_DENSITY = 1.0 / (math.sqrt(2.0 * math.pi) * math.radians(LEVEL_DEG))


@dataclass(frozen=True)
class Figure:
    """A figure of a table: the key of a trial's row, how trials are summed up, its unit, and that in the row's unit."""

    name: str
    key: str
    statistic: str
    unit: str
    scale: float = 1.0


@dataclass(frozen=True)
class Entry:
    """A line of a table: an estimator with options, and the published value of each figure by name."""

    name: str
    estimator: str
    options: Mapping[str, Any]
    published: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class KnownWorld:
    """A world of others by name; `simulate` makes the recording of a root seed and trial, the published number of runs
    is `trials`; `differences` are sentences.

    `ladder`: entries each of which changes one thing of the entry before. `city`: that of a root seed and trial, for
    the figures of the first run; None: no figures are drawn.
    """

    name: str
    title: str
    source: str
    simulate: Callable[[int, int], Recording]
    figures: tuple[Figure, ...]
    entries: tuple[Entry, ...]
    trials: int
    differences: tuple[str, ...]
    ladder: tuple[Entry, ...] = ()
    city: Callable[[int, int], City | None] | None = None


def shuffled(
    snapshot: Ints, link: Ints, vt: Ints, values: Floats, rng: np.random.Generator
) -> tuple[Measurements, Ints]:
    """Return the table of measurements, within a snapshot and link in random order, and the VT (M,) of each row, -1
    clutter; of values (M, 2) of distance (m) and azimuth (rad, NaN where not measured)."""
    order = np.lexsort((rng.random(len(snapshot)), link, snapshot))
    nothing = np.full(len(order), np.nan)
    distance_m, azimuth_rad = values[order].T.copy()
    return Measurements(snapshot[order], link[order], distance_m, azimuth_rad, nothing, nothing), vt[order]


def plane_truth(poses: Floats, vts_m: Floats, site: Ints, vt: Ints, std: Floats) -> Truth:
    """Return the truth of a drive among VTs (V, 2), in m, that stand in the plane, visible all the time; vt (M,): of
    each measurement; std (2,): of distance (m) and azimuth (rad)."""
    count, last, zero = len(vts_m), len(poses) - 1, np.zeros(6)
    whole = np.column_stack([vts_m, np.zeros(count)])
    always = np.column_stack([np.arange(count), np.zeros(count, np.int64), np.full(count, last)])
    deviations = np.where(vt[:, None] < 0, np.nan, np.array([*std, 0.0]))
    first = np.array([whole[site == s][0] for s in range(int(site.max()) + 1)])
    return Truth(
        poses=poses, measurement_vt=vt, measurement_std=deviations,
        vts=VirtualTransmitters(whole, site, np.zeros(count, np.int64), np.full((count, 2), -1), always),
        site_positions_m=first, clock_offsets_m=np.zeros(len(first)), odometry_bias=np.zeros((len(poses), 6)),
        odometry_scale=zero,
    )  # fmt: skip


def one_link_a_site(sites: int) -> Links:
    """Return links, one for each site."""
    none = np.full(sites, -1)
    return Links(np.arange(sites), none, none.copy())
