"""Clutter and misses that last: as many as redrawn, where they are in space, for as long as worked numbers say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from cellslam.sim.frames import unit_vector
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.persisting_errors import draw_fields
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Standing, Streams
from cellslam.sim.lte.statistical.statistical_front_end import Detections, detect
from cellslam.sim.lte.statistical.statistics import statistics
from tests.sim.lte.statistical.test_detector import amplitude_for, make_cells

Floats = NDArray[np.float64]
SIDE = 20.0
ALWAYS = Standing(1.0, SIDE, 0.5, 1.0, 1.0, 0.0, SIDE, 0.0)  # all clutter stands still, and all of it is reported
GAMMA_DB = 25.0


def drive(places: Floats, standing: Standing, seed: int = 1, ports: int = 1, **keys: float | bool) -> Detections:
    """Measure one path from places (T, 2): exact but for the least error of a claim, no noise peaks."""
    own = {"load": 0.0, "evm": 0.0, "noise_scale": 0.0, "detection_threshold": 40.0, "persisting_clutter": True}
    config = RadioConfig(**(own | keys))
    count, amplitude = len(places), amplitude_for(10.0 ** (GAMMA_DB / 10.0), config)
    poses = np.zeros((count, 6))
    poses[:, :2] = places
    paths = PathColumns(
        np.arange(count + 1), np.tile([800.0, 900.0, 0.0], (count, 1)),
        np.tile(amplitude * np.eye(2, dtype=np.complex128), (count, 1, 1)), np.zeros((count, 2)),
    )  # fmt: skip
    fields = draw_fields(config, 0.075, np.random.default_rng(seed))
    streams = Streams.spawn(np.random.default_rng(seed))
    constants = replace(statistics(), standing=standing)
    window = config.model_copy(update={"window_max_m": 6600.0})
    cells = make_cells(0.0, ports=ports)
    return detect(window, cells, paths, poses, np.zeros(1), fields, streams, constants=constants)


def in_space(d: Detections, places: Floats) -> Floats:
    """Return snapshot, link and position to half a metre (C, 5) of clutter."""
    m, clutter = d.measurements, d.path < 0
    at = np.zeros((len(d.path), 3))
    at[:, :2] = places[m.snapshot]
    at += m.distance_m[:, None] * unit_vector(m.azimuth_rad, m.elevation_rad)
    return np.column_stack([m.snapshot, m.link, at])[clutter]


def scatterers(rows: Floats) -> NDArray[np.int64]:
    """Return how often each scatterer is among rows of clutter: rows within 4 m of its first are one."""
    known, counts = np.empty((0, 3)), list[int]()
    for point in rows[:, 2:]:
        near = np.flatnonzero(np.linalg.norm(known - point, axis=1) < 4.0)
        if len(near):
            counts[near[0]] += 1
        else:
            known, counts = np.vstack([known, point]), [*counts, 1]
    return np.array(counts, np.int64)


def along(way_m: float, step_m: float) -> Floats:
    """Return places along an axis."""
    x = np.arange(0.0, way_m, step_m)
    return np.stack([x, np.full_like(x, 7.0)], 1)


def test_scatterers_last_for_the_area_below_their_correlation() -> None:
    # Along an axis the correlation over the way x is 1 - x / side, the area below it, both ways, one side. So on a way
    # of 50 sides 51 draws of Poisson numbers are met, each of the mean, and each scatterer for a side on average.
    way, step = 50.0 * SIDE, 0.5
    places = along(way, step)
    mean = float(statistics().clutter_at(6.0).mean[4])
    rows = [in_space(drive(places, ALWAYS, seed), places) for seed in range(6)]
    met = sum(len(scatterers(r)) for r in rows)
    expected = 6.0 * 51.0 * mean
    assert abs(met - expected) < 5.0 * np.sqrt(expected)
    assert sum(map(len, rows)) * step / met == pytest.approx(SIDE * 50.0 / 51.0, rel=0.1)


def test_as_much_clutter_as_drawn_anew() -> None:
    rng, count = np.random.default_rng(8), 40_000
    places = rng.uniform(-2000.0, 2000.0, (count, 2))
    mean = float(statistics().clutter_at(6.0).mean[4])
    for standing in (ALWAYS, Standing(0.6, SIDE, 0.3, 0.3, 0.5, 0.4, 40.0, 0.3)):
        got = (drive(places, standing).path < 0).sum()
        assert abs(got - mean * count) < 5.0 * np.sqrt(2.0 * mean * count)


def test_a_port_sees_its_share_of_what_another_sees() -> None:
    rng, count, lit = np.random.default_rng(8), 20_000, 0.3
    places = rng.uniform(-2000.0, 2000.0, (count, 2))
    rows = in_space(drive(places, ALWAYS._replace(lit=lit), ports=2), places)
    one, other = (rows[rows[:, 1] == port] for port in range(2))
    places_seen = KDTree(other[:, [0, 2, 3, 4]] * [1e4, 1.0, 1.0, 1.0])  # snapshots far apart
    shared = places_seen.query(one[:, [0, 2, 3, 4]] * [1e4, 1.0, 1.0, 1.0])[0] < 4.0
    assert abs(np.mean(shared) - lit) < 5.0 * np.sqrt(lit * (1.0 - lit) / len(one))


def test_standing_still_repeats_what_is_seen() -> None:
    # A quarter of the scatterers is seen from here, at every snapshot or never; these are reported half the time.
    standing, count = ALWAYS._replace(lit=0.25, reported=0.5), 400
    shares = []
    for seed in range(60):
        places = np.zeros((count, 2))
        rows = in_space(drive(places, standing, seed), places)
        shares += (scatterers(rows) / count).tolist()
    assert len(shares) > 20
    assert abs(np.median(shares) - 0.5) < 5.0 * 0.5 / np.sqrt(count)
    assert np.mean(np.abs(np.array(shares) - 0.5) < 5.0 * 0.5 / np.sqrt(count)) > 0.9  # else two lie within 4 m


@pytest.mark.slow
@pytest.mark.parametrize(("standing", "way"), [((0.0, 0.0), 0.0), ((1.0, 0.0), SIDE), ((0.0, 1.0), 0.5)])
def test_misses_last_as_long_as_their_square(standing: tuple[float, float], way: float) -> None:
    # The chance stays 0.4; of independent draws, one a snapshot or a square, 0.48 follow one of the other kind.
    lasting = ALWAYS._replace(share=0.0, missed_life=standing[0], missed_fading=standing[1])
    places, step = along(6000.0, 0.1), 0.1
    keys = {"clutter_scale": 0.0, "detection_scale": 0.4, "detection_threshold": 17.4}
    for seed in range(4):
        d = drive(places, lasting, seed, **keys)
        found = np.zeros(len(places))
        found[d.measurements.snapshot] = 1.0
        draws = 6000.0 / max(way, step)
        assert abs(found.mean() - 0.4) < 5.0 * np.sqrt(0.24 / draws)
        changes = np.abs(np.diff(found)).sum()
        assert abs(changes - 0.48 * draws) < 5.0 * np.sqrt(0.48 * draws)
