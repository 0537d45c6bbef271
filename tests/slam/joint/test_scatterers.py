"""Scatterers beside mirror images: what is expected of them, how they begin, which kind a VT turns out to be, and that
what is neither stays tentative."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellslam.recordings import Campaign
from cellslam.recordings.importing.campaign import build
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.snapshot.birth_kernel import remove, scatterer_of
from cellslam.slam.joint.snapshot.tentative_kernel import FIRST_SCORE, update_hypotheses
from cellslam.slam.joint.state.layout import IDENT, ILLUMINATOR, MOST_SCORE, SCORE, WEIGHT
from cellslam.slam.joint.state.layout import SCATTERER as IS_SCATTERER
from tests.slam.conftest import OneFilter
from tests.slam.driving import driven
from tests.slam.scattered_worlds import WHITE, World, world

TRANSMITTER, SCATTERER = (12.0, 0.4, 0.1), (7.0, -0.9, 0.05)  # range, azimuth, elevation about the anchor
Q = np.array([0.1, 0.01, 0.01]) ** 2


def filter_with_scatterer(one_filter: type[OneFilter], scale: float | None = None) -> OneFilter:
    """A filter with a transmitter, VT 0, which illuminates VT 1, a scatterer."""
    one = one_filter(scale=scale)
    one.put([1.0, 0.5, 0.2, 0.3, 0.02, 0.01], 4.0, TRANSMITTER, SCATTERER)
    one.f.vts.slots[:2, IDENT], one.f.illuminators[0] = [5, 6], 0
    one.f.vts.slots[1, [IS_SCATTERER, ILLUMINATOR]] = 1, 0
    return one


def test_the_path_over_a_scatterer_is_as_long_as_both_ways(one_filter: type[OneFilter]) -> None:
    one = filter_with_scatterer(one_filter, scale=0.05)
    here, point, illuminator = one.f.x[:3], one.place(1), one.place(0)
    z, h = one.model(1)
    assert z[0] == pytest.approx(1.05 * (np.linalg.norm(point - here) + np.linalg.norm(point - illuminator)) + 4.0)
    for i in range(one.n):
        before, step = one.f.x[i], 1e-6
        one.f.x[i] = before + step
        after = one.model(1)[0]
        one.f.x[i] = before
        np.testing.assert_allclose((after - z) / step, h[:, i], atol=2e-5)


def test_a_scatterer_begins_where_the_ray_meets_the_ellipsoid(one_filter: type[OneFilter]) -> None:
    one = one_filter()
    one.put(np.zeros(6), 0.0, TRANSMITTER, (20.0, -0.9, 0.05), anchor=(1.0, 2.0, 0.0))
    one.f.vts.slots[:2, IDENT], one.f.illuminators[0] = [5, 6], 0
    p = one.spread(0.1 * np.random.default_rng(1).standard_normal((one.n, one.n)))
    n, anchor = one.n, one.f.vts.anchor[1, :3]

    def begun(x: Floats) -> Floats:
        """Return the scatterer's coordinates for a state x, by bisection; the receiver goes with the vehicle."""
        kept, one.f.x[:n] = one.f.x[:n].copy(), x
        receiver = x[:3] + Rotation.from_euler("z", x[3]).apply(anchor)
        illuminator, to_vt = one.place(0), one.place(1) - receiver
        total = float(np.linalg.norm(to_vt))
        low, high = 0.0, total
        for _ in range(60):
            middle = 0.5 * (low + high)
            point = receiver + middle / total * to_vt
            too_long = middle + np.linalg.norm(point - illuminator) > total
            low, high = (low, middle) if too_long else (middle, high)
        one.f.x[:n] = kept
        east, north, up = receiver + low / total * to_vt - anchor
        flat = np.hypot(east, north)
        return np.array([np.hypot(flat, up), np.arctan2(north, east), np.arctan2(up, flat)])

    x = one.f.x[:n].copy()
    by = np.stack([(begun(x + 1e-5 * e) - begun(x - 1e-5 * e)) / 2e-5 for e in np.eye(n)], axis=1)
    scatterer_of(one.f, one.block, 1, one.w.jacobian, one.w.pending)
    at = one.f.vts.state[2, :3]
    np.testing.assert_allclose(one.f.x[at], begun(x), atol=1e-9)
    np.testing.assert_allclose(one.f.p[np.ix_(at, np.arange(n))], by @ p, atol=1e-6)
    np.testing.assert_allclose(one.f.p[np.ix_(at, at)], by @ p @ by.T, atol=1e-6)
    assert one.f.vts.slots[:3, IS_SCATTERER].tolist() == [0, 0, 1]
    assert one.f.vts.slots[:3, ILLUMINATOR].tolist() == [-1, 0, 0]
    assert one.f.vts.anchor[1:3, WEIGHT].tolist() == [0.5, 0.5]


def test_scatterers_go_with_their_illuminator_and_others_keep_theirs(one_filter: type[OneFilter]) -> None:
    one = one_filter()
    one.put(np.zeros(6), 0.0, TRANSMITTER, SCATTERER, SCATTERER, TRANSMITTER, SCATTERER)
    one.f.vts.slots[:5, IS_SCATTERER], one.f.illuminators[0] = [0, 1, 0, 0, 1], 3
    illuminator = one.f.vts.slots[:5, ILLUMINATOR]
    illuminator[:] = [-1, 0, 0, -1, 3]
    remove(one.f, one.block, 1)  # VT 4 takes its number
    assert illuminator[:4].tolist() == [-1, 3, 0, -1]
    remove(one.f, one.block, 0)  # VT 3, the illuminator of VT 1, takes its number
    assert one.f.illuminators[0] == 0 and illuminator[:3].tolist() == [-1, 0, -1]
    remove(one.f, one.block, 0)
    assert one.f.illuminators[0] == -1 and (illuminator[:2] == -1).all()
    assert sorted(one.f.vts.anchor[:2, WEIGHT].tolist()) == [0.0, 1.0]  # a mirror image needs no illuminator


@pytest.mark.parametrize("off", [0.5, 8.0])
def test_a_vt_is_confirmed_by_measurements_that_fit_and_deleted_by_those_that_do_not(
    one_filter: type[OneFilter], off: float
) -> None:
    one = one_filter(scatterers=True)
    one.put(np.zeros(6), 0.0, TRANSMITTER)
    one.spread(0.001 * np.eye(one.n))
    one.f.vts.anchor[0, SCORE] = FIRST_SCORE
    for n in range(12):
        deviation = 0.5 if n < 4 else off * (-1.0) ** n
        z = one.model(0)[0] + deviation * np.sqrt(Q)
        update_hypotheses(
            one.f, one.errors, 0, one.offset, one.measurement(z, Q), 9.0, one.rules, one.w.jacobian, one.w.pending
        )
        if n == 0:
            assert one.f.vts.anchor[0, SCORE] < 0.0 and not one.w.pending.added[:6].any()  # the pose learns nothing yet
        if one.f.vts.anchor[0, WEIGHT] == 0.0:
            break
        if n == 3:
            assert one.f.vts.anchor[0, SCORE] == MOST_SCORE and one.w.pending.added[:6].any()
    assert (one.f.vts.anchor[0, WEIGHT] == 1.0) == (off < 1.0)


def of(w: World, rows: Any) -> Recording:
    """The recording of a world with some of its measurements."""
    m = w.recording.measurements
    some = {name: getattr(m, name)[rows] for name in ("snapshot", "link", "distance_m", "azimuth_rad", "elevation_rad")}
    return replace(w.recording, measurements=replace(m, snr_db=m.snr_db[rows], **some))


def check_map(vts: VtEstimate, w: World) -> None:
    """Check that nearly all VTs are features of a world, and of their kinds."""
    apart = np.linalg.norm(w.features - vts.position_m[:, None], axis=2)
    near = apart.min(axis=1) < 3.0
    assert near.mean() > 0.9 and len(vts.id) > 15
    assert (vts.scatterer == w.scatters[apart.argmin(axis=1)])[near].all()


@pytest.mark.parametrize("estimator", [EkfSlam, FastSlam])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("share", [0.2, 0.8])
def test_mirrors_and_scatterers_are_told_apart(estimator: Any, known: bool, share: float) -> None:
    w = world(3, share, features=20, steps=200, known=known)
    answers = driven(estimator(estimator.Options(**WHITE)), w.recording)
    alone = w.rmse_m(driven(EkfSlam(EkfSlam.Options(**WHITE)), of(w, w.of == 0)))
    assert w.rmse_m(answers) < 0.6 * alone
    check_map(answers[-1].vts, w)


@pytest.mark.parametrize("estimator", [EkfSlam, FastSlam])
def test_random_paths_do_not_spoil_the_line_of_sight(estimator: Any) -> None:
    w = world(4, 0.5, features=0, steps=120, random=8)
    answers = driven(estimator(estimator.Options(**WHITE)), w.recording)
    alone = driven(estimator(estimator.Options(**WHITE)), of(w, w.of == 0))
    assert w.rmse_m(answers) < 1.2 * w.rmse_m(alone)
    assert len(answers[-1].vts.id) <= 2  # nothing that is tentative is in the map


def test_a_transmitter_seen_late_illuminates_what_was_there_before() -> None:
    w = world(6, 0.6, features=20, steps=160)
    late = of(w, (w.of != 0) | (w.recording.measurements.snapshot > 25))
    check_map(driven(EkfSlam(EkfSlam.Options(**WHITE)), late)[-1].vts, w)


def test_a_campaign_may_have_scatterers_unless_it_is_of_landmarks(tmp_path: Path) -> None:
    given = {"odometry": None, "start_pose": (0.0,) * 6, "plane": True}
    columns = {"distance_m": [5.0, 6.0], "azimuth_rad": [0.0, 0.1]}
    paths = build(Campaign([0.0, 1.0], columns, **given))
    assert paths.scatterers
    assert not build(Campaign([0.0, 1.0], columns, scatterers=False, **given)).scatterers
    assert not build(Campaign([0.0, 1.0], {"distance_m": [5.0, 6.0]}, **given)).scatterers
    paths.save(tmp_path / "paths.h5")
    assert Recording.load(tmp_path / "paths.h5").scatterers
