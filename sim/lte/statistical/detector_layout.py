"""What the compiled detector reads and writes: constants of the model, links, traced paths, output columns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
# Output columns.
SNAPSHOT, LINK, DISTANCE, AZIMUTH, ELEVATION, SNR_DB = 0, 1, 2, 3, 4, 5
CLAIMED_STD, TRUE_STD, PATH, MERGING_SHIFT, COLUMNS = 6, 9, 12, 13, 16
# More clutter of one kind from one cause than this is not drawn: far beyond what the config's ranges reach.
MOST_CLUTTER = 512
NEIGHBOUR_M = 40.0
ISOLATED_LEFTOVER = 0.9
GHOST_REACH_M = 10.0
# Nodes of integrated SNR over which clutter was measured.
GAMMA_START_DB, GAMMA_STEP_DB = 5.0, 5.0
# How far behind a path its diffuse energy reaches, how far to its sides (deviation), and over what delay it decays.
DIFFUSE_TO_M, TRAIL_BESIDE_RAD, TRAIL_DECAY_M = 150.0, 0.35, 35.0
# What is stronger than this share of a path is not taken for its diffuse energy, and not disturbed by it.
DIFFUSE_SHARE = 1.0
DISTURBED = 1.5  # disturbance over noise from which detection is no longer that of an isolated path
# Probability table over Gamma' in dB.
TABLE_START_DB, TABLE_STEP_DB = -20.0, 0.05


class LinkTable(NamedTuple):
    """Links (L,) sorted as in the recording, and the cells (C,) that they belong to; `slant` (L, 2) is (H,
    V).
    """

    site: Array
    cell: Array
    port: Array
    slant: Array
    cell_site: Array
    cell_azimuth: Array
    cell_tilt: Array
    cell_ports: Array


class PathColumns(NamedTuple):
    """Traced paths (P,) as the front ends read them, sorted by (receiver, site).

    `rows` (T S + 1,): paths of receiver t and site s are rows[t S + s] up to rows[t S + s + 1] of `vt_m` (P, 3) in m,
    `gain` (P, 2, 2) as [received, sent] amplitudes in (H, V), and `departure_rad` (P, 2) azimuth and elevation in the
    world.
    """

    rows: NDArray[np.int64]
    vt_m: NDArray[np.float64]
    gain: NDArray[np.complex128]
    departure_rad: NDArray[np.float64]


class Streams(NamedTuple):
    """The generators of a front end: noise, detection, clutter. They advance with every snapshot."""

    noise: np.random.Generator
    detection: np.random.Generator
    clutter: np.random.Generator

    @staticmethod
    def spawn(rng: np.random.Generator) -> Streams:
        """Return three independent children of `rng`."""
        return Streams(*rng.spawn(3))


class Standing(NamedTuple):
    """What stands still: the `share` of clutter around paths that does; the side of the squares of ground within which
    the scatterers behind a path are the same (`life_m`), and of those within which a port sees the same of them
    (`fading_m`); the share of these in which it sees a scatterer (`lit`), and the chance that this is then reported
    (`reported`). Share of paths that are seen or missed for as long as squares of `missed_life_m` last (`missed_life`),
    or those of the fading (`missed_fading`). `world`: key of the trial's surroundings.
    """

    share: float
    life_m: float
    fading_m: float
    lit: float
    reported: float
    missed_life: float
    missed_life_m: float
    missed_fading: float
    world: np.uint64 = np.uint64(0)


NOTHING_STANDS = Standing(0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0)


class Model(NamedTuple):
    """The radio configuration in linear units; scales as in `BoundScales`, floors are standard deviations, of all
    causes and of the white ones.

    `threshold`: least energy over disturbance that is detected; `detection`: probability that an isolated path exceeds
    it, over integrated SNR from TABLE_START_DB in steps of TABLE_STEP_DB. `trail`, `around`: disturbance that a
    stronger path's diffuse energy adds in the same direction and in all, per integrated SNR; `sidelobes`: share of it
    that spreads over `sidelobe_m` of delay. `company`: how many times as much clutter there is around a path among
    others as around a lone one. Clutter around a path over nodes (G,) of its integrated SNR: mean number (G,), points
    (G, N, 4): later (m), beside and above (rad), SNR (dB), blurred by `blur_m`. `standing`: what of clutter and misses
    stands still.
    """

    eirp: float
    noise: float
    load: float
    evm_power: float
    snr_cap: float
    samples: float
    distance_scale: float
    azimuth_scale: float
    elevation_scale: float
    distance_floor: float
    azimuth_floor: float
    elevation_floor: float
    distance_white: float
    azimuth_white: float
    elevation_white: float
    noise_scale: float
    threshold: float
    detection: Array
    detection_scale: float
    perfect: bool
    window_min: float
    window_max: float
    noise_clutter: float
    ghost_rule: float
    overlap_centre_db: float
    overlap_width_db: float
    trail: float
    around: float
    sidelobes: float
    sidelobe_m: float
    company: float
    clutter_mean: Array
    clutter_points: Array
    blur_m: float
    standing: Standing
