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
NEIGHBOUR_M = 40.0  # overlap farther apart is left out: at 18 MHz it is below 1e-7
ISOLATED_LEFTOVER = 0.9  # of what has more than this share left, detection is that of an isolated path
GHOST_REACH_M = 10.0  # within which a much weaker path counts as a ghost of calibration error
# Nodes of integrated SNR over which clutter was measured.
GAMMA_START_DB, GAMMA_STEP_DB = 5.0, 5.0
# How far behind a path its diffuse energy reaches, how far to its sides (deviation), and over what delay it decays.
DIFFUSE_TO_M, TRAIL_BESIDE_RAD, TRAIL_DECAY_M = 150.0, 0.35, 35.0
# What is stronger than this share of a path is not taken for its diffuse energy, and not disturbed by it.
DIFFUSE_SHARE = 1.0
# The array's azimuth information falls as cos(el)^1.8; its elevation information a little with el^2 (0.089 deg at 45).
AZIMUTH_EXPONENT, ELEVATION_GROWTH = 0.9, 0.43
DISTURBED = 1.5  # disturbance over noise from which detection is no longer that of an isolated path
# Probability table over Gamma' in dB.
TABLE_START_DB, TABLE_STEP_DB = -20.0, 0.05


class LinkTable(NamedTuple):
    """Links (L,) sorted as in the recording, and the cells (C,) that they belong to; `slant` (L, 2) is (H, V)."""

    site: Array
    cell: Array
    port: Array
    slant: Array
    cell_site: Array
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

    def of_snapshots(self, first: int, last: int, sites: int) -> tuple[PathColumns, int]:
        """Return the paths of receivers `first` up to `last`, not included, and the row of the first path."""
        rows = self.rows[first * sites : last * sites + 1]
        low, high = int(rows[0]), int(rows[-1])
        return PathColumns(rows - low, self.vt_m[low:high], self.gain[low:high], self.departure_rad[low:high]), low


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


NOTHING_STANDS = Standing(
    share=0.0, life_m=1.0, fading_m=1.0, lit=1.0, reported=1.0, missed_life=0.0, missed_life_m=1.0, missed_fading=0.0
)


class Budget(NamedTuple):
    """Link budget: power sent and noise in mW per resource element; `load`, the share of them that other cells fill;
    `evm_power`, a path's own power that comes back as noise, and the highest SNR per sample, `snr_cap`, as ratios;
    `samples`, N = Gamma / rho.
    """

    eirp_mw: float
    noise_mw: float
    load: float
    evm_power: float
    snr_cap: float
    samples: float


class Spread(NamedTuple):
    """A width or standard deviation of each measured component."""

    distance_m: float
    azimuth_rad: float
    elevation_rad: float


class Accuracy(NamedTuple):
    """Errors: `bound`, deviation times sqrt(2 Gamma) as in `BoundScales`, also the width of a path's ambiguity; floors,
    of all causes (`floor`) and of what is redrawn for every measurement (`white`). `scale` multiplies all of them.
    """

    bound: Spread
    floor: Spread
    white: Spread
    scale: float


class Detection(NamedTuple):
    """What is detected: `threshold`, least energy over disturbance; `isolated`, the probability that a path alone
    exceeds it, over integrated SNR from TABLE_START_DB in steps of TABLE_STEP_DB; `scale` multiplies probabilities;
    `perfect`: all paths are. Nothing is looked for outside the window of delay.
    """

    threshold: float
    isolated: Array
    scale: float
    perfect: bool
    window_min_m: float
    window_max_m: float


class Overlap(NamedTuple):
    """What stronger paths do: `trail` and `around`, disturbance that their diffuse energy adds in the same direction
    and in all, per integrated SNR; `sidelobes`, share of it that spreads over `sidelobe_m` of delay. Detection is then
    a logistic in integrated SNR. What has less than `ghost_share` of a stronger path nearby is taken for its ghost.
    """

    centre_db: float
    width_db: float
    ghost_share: float
    trail: float
    around: float
    sidelobes: float
    sidelobe_m: float


class ClutterModel(NamedTuple):
    """Mean number of `noise_peaks` per link and snapshot; around a path, over nodes (G,) of its integrated SNR: `mean`
    number (G,) and `points` (G, N, 4): later (m), beside and above (rad), SNR (dB), blurred by `blur_m`; `company`: how
    many times as much there is around a path among others as around a lone one.
    """

    noise_peaks: float
    mean: Array
    points: Array
    blur_m: float
    company: float


class Model(NamedTuple):
    """The radio configuration in linear units; `standing`: what of clutter and misses stands still."""

    budget: Budget
    accuracy: Accuracy
    detection: Detection
    overlap: Overlap
    clutter: ClutterModel
    standing: Standing
