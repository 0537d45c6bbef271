"""How clutter recurs: one scene by hand, and constants found again from the recurrence that they give."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.lte.calibration.recurrence import (
    LINKS,
    SHIFTS_M,
    Recurrence,
    draw_scene,
    fit_standing,
    recurrence,
    same_square,
)
from cellslam.sim.lte.calibration.scenes import config_of
from cellslam.sim.lte.statistical import detector_layout as k


def test_recurrence_of_one_scene_by_hand() -> None:
    scene = draw_scene(np.random.default_rng(4), config_of(6.0))
    point, last = scene.poses[0, :3] + np.array([100.0, 40.0, 20.0]), len(SHIFTS_M)
    rows = []

    def report(snapshot: int, link: int, path: int, moved_m: float = 0.0) -> None:
        pose, row = scene.poses[snapshot], np.full(k.COLUMNS, np.nan)
        to = point - pose[:3]
        row[k.SNAPSHOT], row[k.LINK], row[k.PATH] = snapshot, link, path
        row[k.DISTANCE] = np.linalg.norm(to) + moved_m
        row[k.AZIMUTH] = np.arctan2(to[1], to[0]) - pose[3]
        row[k.ELEVATION] = np.arctan2(to[2], np.hypot(to[0], to[1]))
        rows.append(row)

    for snapshot in (0, 1, 2, last):  # the same scatterer from four places, on one link
        report(snapshot, 2, -1)
    report(3, 2, -1, moved_m=12.0)  # another one, farther than half a resolution cell
    report(4, 3, -1)  # on the other port
    report(5, 4, -1)  # on another cell
    report(0, 1, 0)  # a path that both ports of the first cell see, first and last
    report(last, 1, 0)
    report(last, 0, 0)
    paths = len(scene.paths.vt_m)
    chance = np.zeros((LINKS, paths))
    chance[:2, 0] = 0.5
    r = recurrence([scene], [np.array(rows)], [chance])
    assert r.clutter == 1
    assert np.flatnonzero(r.link).tolist() == [0, 1, last - 1]
    assert np.flatnonzero(r.port).tolist() == [3]
    assert r.link.max() == r.port.max() == 1.0
    assert r.twice == 1.0
    # First snapshot: port 0 missed, port 1 seen: -1/2 and 1/2. Then both missed: correlation 0; at last both seen.
    assert r.weight == pytest.approx(0.5)
    assert r.missed_link.tolist() == pytest.approx([0.0] * last)
    assert r.missed_port.tolist() == pytest.approx([0.0] * last)


def test_constants_are_found_again() -> None:
    way, nothing = np.array(SHIFTS_M), np.full(len(SHIFTS_M), 0.07)
    share, reported, lit, life, fading = 0.5, 0.6, 0.2, 25.0, 0.4
    missed_life, missed_life_m, missed_fading = 0.25, 40.0, 0.1
    long, short = same_square(way / life), same_square(way / fading)
    lasting = missed_life * same_square(way / missed_life_m)
    link = share * reported * long * (short + (1.0 - short) * lit)
    port = share * reported * long * lit
    white = Recurrence(100, nothing, nothing, 0.01, 50.0, 0.0 * way, 0.0 * way)
    signal = Recurrence(
        100, 0.07 + 0.93 * link, 0.07 + 0.93 * port, 0.01 + 0.99 * share * reported**2, 50.0,
        lasting + missed_fading * short, lasting,
    )  # fmt: skip
    found = fit_standing(signal, white)
    expected = (share, life, fading, lit, reported, missed_life, missed_life_m, missed_fading)
    np.testing.assert_allclose([found[name] for name in k.Standing._fields[:8]], expected, rtol=0.02)
