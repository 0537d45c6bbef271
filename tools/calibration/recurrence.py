"""How clutter recurs, and how misses last, as the receiver moves: measured in either front end, and fitted.

A scene is a site of three sectors and two ports whose paths are received from several places along a line, at the usual
load and transmitter error. Clutter recurs where a link, or the other port of its cell, reports clutter where the same
point of space would be seen from the other place.

Source: own derivation, docs/explanation/persisting-errors.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cellslam.sim.frames import azimuth_elevation, unit_vector, wrap_angle
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.links import Cells, cells_of
from cellslam.sim.lte.persisting_errors import draw_fields
from cellslam.sim.lte.signal.receiver import receiver_of
from cellslam.sim.lte.signal.signal_front_end import SAME_PATH, signal_level
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Streams
from cellslam.sim.lte.statistical.statistical_front_end import detect
from cellslam.sim.lte.statistical.statistics import Statistics, statistics
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats
from tools.calibration.front_end_check import Figure
from tools.calibration.scenes import POSE, config_of, in_scene, scenes_of

RATIO_DB = 6.0
# Ways from the first snapshot; two more are at its place: whether both repeat it tells seldom from often.
SHIFTS_M = (0.0, 0.0, 0.1, 0.3, 1.0, 4.0, 10.0, 25.0)
LINKS, PORTS, ACROSS_M = 6, 2, 20.0
DRAWS, REPEATS = 200, 8  # of the statistical front end, which is cheap: for the chance of each path, of each scene
LONGEST_M = 60.0  # what lasts longer cannot be told from what lasts for as long
CLUTTER_LIMIT, MISSES_LIMIT = 0.1, 0.2  # of the check, for shares and correlations


@dataclass(frozen=True)
class Scene:
    """A site, its paths, and the poses (1 + shifts, 6) of all snapshots."""

    cells: Cells
    paths: PathColumns
    poses: Floats


class Recurrence(NamedTuple):
    """How many points of clutter the first snapshots hold, and the share of them that recurs in each later one (S,): on
    the same link, on the cell's other port; `twice`: in both of the first two. The weight of the paths, the sum of
    c (1 - c) over their detection probabilities c, and the correlation (S,) of their misses, given c, on the same link
    and on the other port.
    """

    clutter: int
    link: Floats
    port: Floats
    twice: float
    weight: float
    missed_link: Floats
    missed_port: Floats


def config_of_scenes(ratio_db: float, radio: RadioConfig | None = None) -> RadioConfig:
    """Return the radio configuration of the scenes: that of the other studies with load and transmitter error."""
    usual = RadioConfig()
    return config_of(ratio_db, radio).model_copy(
        update={"load": usual.load, "evm": usual.evm, "snr_cap_db": usual.snr_cap_db}
    )


def draw_scene(rng: np.random.Generator, config: RadioConfig) -> Scene:
    """Draw a scene: two to eight paths, sectors and line of travel turned anyhow."""
    paths = scenes_of(rng, 1, config)[0]
    sectors = np.degrees(rng.uniform(-np.pi, np.pi)) + 120.0 * np.arange(3)
    cells = [SimpleNamespace(cell_id=375 + i, azimuth_deg=a, tilt_deg=8.0) for i, a in enumerate(sectors)]
    corner, line = np.append(rng.uniform(0.0, ACROSS_M, 2), 0.0), unit_vector(rng.uniform(-np.pi, np.pi), 0.0)
    poses = np.tile(POSE, (1 + len(SHIFTS_M), 1))
    poses[:, :3] += corner + np.array([0.0, *SHIFTS_M])[:, None] * line
    moved = paths._replace(vt_m=paths.vt_m + corner)
    return Scene(cells_of([SimpleNamespace(cells=cells, ports=PORTS)]), moved, poses)


def seen_by_signals(
    config: RadioConfig, scenes: list[Scene], rng: np.random.Generator, progress: Progress
) -> list[Floats]:
    """Return what the signal level reports (M, COLUMNS), m, rad, dB, of each scene."""
    still, out = np.zeros(3), []
    with progress("measuring how clutter recurs", len(scenes)) as advance:
        for scene in scenes:
            base = signal_level(config, scene.cells, np.zeros(1), draw_fields(config, 0.075, rng), rng)
            front_end = in_scene(base, rng)
            snapshots = [front_end.measure(scene.paths, p, still, still, n, rng) for n, p in enumerate(scene.poses)]
            out.append(np.concatenate(snapshots))
            advance(1)
    return out


def seen_by_statistics(
    config: RadioConfig, scenes: list[Scene], rng: np.random.Generator, constants: Statistics, persisting: bool
) -> list[list[Floats]]:
    """Return what the statistical front end reports (M, COLUMNS), m, rad, dB, of each scene, REPEATS times over."""
    keys = {"front_end": "statistical", "persisting_clutter": persisting}
    config = config.model_copy(update=keys)
    return [[_drawn(config, scene, scene.poses, rng, constants) for scene in scenes] for _ in range(REPEATS)]


def chances(config: RadioConfig, scenes: list[Scene], rng: np.random.Generator, constants: Statistics) -> list[Floats]:
    """Return the detection probability (LINKS, n) of each scene's paths at the first snapshot."""
    config = config.model_copy(update={"front_end": "statistical", "clutter_scale": 0.0})
    out = []
    for scene in scenes:
        table = _drawn(config, scene, np.tile(scene.poses[0], (DRAWS, 1)), rng, constants)
        out.append(_found(table, DRAWS, len(scene.paths.vt_m)).mean(axis=0))
    return out


def _drawn(
    config: RadioConfig, scene: Scene, poses: Floats, rng: np.random.Generator, constants: Statistics
) -> Floats:  # fmt: skip
    n, count = len(scene.paths.vt_m), len(poses)
    p = scene.paths
    paths = PathColumns(
        n * np.arange(count + 1), np.tile(p.vt_m, (count, 1)), np.tile(p.gain, (count, 1, 1)),
        np.tile(p.departure_rad, (count, 1)),
    )  # fmt: skip
    fields, streams = draw_fields(config, 0.075, rng, constants), Streams.spawn(rng)
    d = detect(config, scene.cells, paths, poses, np.zeros(1), fields, streams, constants=constants)
    table, m = np.full((len(d.path), k.COLUMNS), np.nan), d.measurements
    table[:, k.SNAPSHOT], table[:, k.LINK], table[:, k.SNR_DB] = m.snapshot, m.link, m.snr_db
    table[:, k.DISTANCE], table[:, k.AZIMUTH], table[:, k.ELEVATION] = m.distance_m, m.azimuth_rad, m.elevation_rad
    table[:, k.PATH] = np.where(d.path >= 0, d.path % n, -1)
    return table


def recurrence(scenes: list[Scene], tables: list[Floats], chance: list[Floats], finer: float = 1.0) -> Recurrence:
    """Return how the clutter of the first snapshot recurs in the later ones, and how misses last; of scenes, what is
    reported (M, COLUMNS) of each and the chances (LINKS, n) of its paths. `finer`: resolution over LTE's.
    """
    shifts = len(SHIFTS_M)
    number, link, port, twice = 0, np.zeros(shifts), np.zeros(shifts), 0.0
    weight, missed_link, missed_port = 0.0, np.zeros(shifts), np.zeros(shifts)
    for scene, table, c in zip(scenes, tables, chance, strict=True):
        clutter = table[table[:, k.PATH] < 0.0]
        first = clutter[clutter[:, k.SNAPSHOT] == 0.0]
        toward = unit_vector(first[:, k.AZIMUTH] + scene.poses[0, 3], first[:, k.ELEVATION])
        point, own = scene.poses[0, :3] + first[:, [k.DISTANCE]] * toward, first[:, k.LINK].astype(int)
        hits = _recurs(clutter, point, own, scene.poses, finer)
        number += len(first)
        link, port = link + hits.sum(axis=1), port + _recurs(clutter, point, own ^ 1, scene.poses, finer).sum(axis=1)
        twice += float((hits[0] & hits[1]).sum())
        left = _found(table, 1 + shifts, c.shape[1]) - c
        weight += float(np.sum(c * (1.0 - c)))
        missed_link += np.einsum("ln,sln->s", left[0], left[1:])
        missed_port += np.einsum("ln,sln->s", left[0], left[1:][:, np.arange(LINKS) ^ 1])
    every, least = max(number, 1), max(weight, 1e-9)
    return Recurrence(
        number, link / every, port / every, twice / every, weight, missed_link / least, missed_port / least
    )


def _recurs(clutter: Floats, point: Floats, link: np.ndarray, poses: Floats, finer: float) -> np.ndarray:
    """Return whether each later pose (S, n) sees clutter on a link (n,) where it would see a point (n, 3) of space."""
    out = np.zeros((len(poses) - 1, len(point)), np.bool_)
    for snapshot, pose in enumerate(poses[1:], 1):
        there = clutter[clutter[:, k.SNAPSHOT] == snapshot]
        azimuth, elevation = azimuth_elevation(point - pose[:3])
        seen = np.stack([np.linalg.norm(point - pose[:3], axis=1), azimuth - pose[3], elevation], 1)
        apart = there[None, :, [k.DISTANCE, k.AZIMUTH, k.ELEVATION]] - seen[:, None]
        apart[..., 1] = wrap_angle(apart[..., 1])
        near = np.sum((apart / (SAME_PATH * [finer, 1.0, 1.0])) ** 2, axis=-1) < 1.0
        out[snapshot - 1] = (near & (there[:, k.LINK] == link[:, None])).any(axis=1)
    return out


def _found(table: Floats, snapshots: int, paths: int) -> Floats:
    """Return which paths were found, 1 or 0: (snapshots, LINKS, paths)."""
    out = np.zeros((snapshots, LINKS, paths))
    rows = table[table[:, k.PATH] >= 0.0][:, [k.SNAPSHOT, k.LINK, k.PATH]].astype(int)
    out[rows[:, 0], rows[:, 1], rows[:, 2]] = 1.0
    return out


def same_square(way: Floats) -> Floats:
    """Return the probability (S,) that two places lie in one square, being `way` (S,) of its sides apart in any
    direction; those more than a side apart, which only a diagonal holds, count as 0.
    """
    return np.asarray(np.where(way < 1.0, 1.0 - (4.0 * way - way * way) / np.pi, 0.0), np.float64)


def fit_standing(signal: Recurrence, white: Recurrence) -> dict[str, float]:
    """Return the constants of what stands still: least squares over the recurrence of clutter and misses, less what
    `white`, redrawn at every snapshot, has by chance.
    """
    way, start = np.array(SHIFTS_M), np.array([0.5, 0.4, 0.3, 20.0, 0.3, 0.3, 30.0, 0.1])
    measured = np.concatenate([
        (signal.link - white.link) / (1.0 - white.link), (signal.port - white.port) / (1.0 - white.port),
        [(signal.twice - white.twice) / (1.0 - white.twice)], signal.missed_link, signal.missed_port,
    ])  # fmt: skip

    def left(p: Floats) -> Floats:
        share, reported, lit, life_m, fading_m, missed_life, missed_life_m, missed_fading = p
        life, near = same_square(way / life_m), same_square(way / fading_m)
        link = share * reported * life * (near + (1.0 - near) * lit)
        port = share * reported * life * lit
        missed = missed_life * same_square(way / missed_life_m)
        return np.asarray(
            np.concatenate([link, port, [share * reported**2], missed + missed_fading * near, missed]) - measured
        )

    low, high = [0.0, 0.05, 0.02, 5.0, 0.05, 0.0, 5.0, 0.0], [1.0, 1.0, 1.0, LONGEST_M, 2.0, 0.7, LONGEST_M, 0.3]
    best = least_squares(left, start, bounds=(low, high)).x
    names = ("share", "reported", "lit", "life_m", "fading_m", "missed_life", "missed_life_m", "missed_fading")
    return {name: float(value) for name, value in zip(names, best, strict=True)}


def standing(
    radio: RadioConfig, count: int, rng: np.random.Generator, constants: Statistics, progress: Progress
) -> tuple[dict[str, float], dict[str, Any]]:
    """Return the constants of what stands still, and the recurrence that they are fitted to, of `count` scenes."""
    signal, white = _both(config_of_scenes(RATIO_DB, radio), count, rng, constants, False, progress)
    measured = {name: np.asarray(value).tolist() for name, value in signal._asdict().items()}
    return fit_standing(signal, white), {"shifts_m": list(SHIFTS_M), **measured}


def recurring(radio: RadioConfig, count: int, seed: int, ratio_db: float, progress: Progress) -> list[Figure]:
    """Return how clutter recurs and misses last in the two front ends, in `count` scenes that no calibration sees."""
    rng = np.random.default_rng([seed, 5, round(10.0 * ratio_db)])
    config, constants = config_of_scenes(ratio_db, radio), statistics(radio.statistics_band)
    signal, drawn = _both(config, count, rng, constants, True, progress)
    out = []
    for what, name, limit, number in (
        ("clutter seen again", "link", CLUTTER_LIMIT, signal.clutter),
        ("clutter seen on the other port", "port", CLUTTER_LIMIT, signal.clutter),
        ("misses of a link, correlation", "missed_link", MISSES_LIMIT, round(signal.weight)),
        ("misses of two ports, correlation", "missed_port", MISSES_LIMIT, round(signal.weight)),
    ):
        for snapshot, way in list(enumerate(SHIFTS_M))[1:]:
            pair = float(getattr(signal, name)[snapshot]), float(getattr(drawn, name)[snapshot])
            out.append(Figure(f"{what}, {way:g} m", *pair, limit, True, number))
    return out


def _both(
    config: RadioConfig,
    count: int,
    rng: np.random.Generator,
    constants: Statistics,
    persisting: bool,
    progress: Progress,
) -> tuple[Recurrence, Recurrence]:
    """Return the recurrence at signal level and in the statistical front end, in the same scenes."""
    scenes, draws = [draw_scene(rng, config) for _ in range(count)], rng.spawn(1)[0]
    signals = seen_by_signals(config, scenes, rng, progress)
    chance = chances(config, scenes, draws, constants)
    drawn = seen_by_statistics(config, scenes, draws, constants, persisting)
    finer = receiver_of(config.waveform()).finer
    several = recurrence(scenes * REPEATS, [table for tables in drawn for table in tables], chance * REPEATS, finer)
    return recurrence(scenes, signals, chance, finer), several
