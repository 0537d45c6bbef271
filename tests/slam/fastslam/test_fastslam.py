"""FastSLAM's parts and the filter as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.fastslam import path_particles as filter_module
from cellslam.slam.fastslam.best_map import map_of
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.fastslam.snapshot.measurement_kernel import pack
from cellslam.slam.fastslam.state.layout import LANES, POSE, THETA
from cellslam.slam.fastslam.state.particles import draw, select
from cellslam.slam.front_end.front_end_options import NOTHING_PERSISTS
from cellslam.slam.front_end.looks import Grouping
from cellslam.slam.front_end.readings import novelty, readings
from cellslam.slam.front_end.readings_kernel import count_sharers
from cellslam.slam.model.measurement_model import predict

SMALL = FastSlamOptions(errors="counted", particles=64, vts_per_link=8, start_phase_s=0.0, sharing="none")


def make_setup(links: int = 2, offset_std: float = 0.0) -> Setup:
    zero = np.zeros(6)
    sheet = OdometryModel(
        np.array([0.01, 0, 0, 1e-3, 0, 0]), np.array([0, 0, 0, 1e-4, 0, 0]), zero, np.array([0.01, 0, 0, 0, 0, 0])
    )
    table = Links(np.zeros(links, np.int64), np.arange(links), np.zeros(links, np.int64))
    return Setup(table, Sites(("A",), np.zeros(1), np.full(1, offset_std)), sheet, np.zeros(6), np.zeros(6))


def make_snapshot(t: int, rows: list[tuple[int, float, float, float]]) -> Snapshot:
    link, d, az, el = (
        (np.array(c) for c in zip(*rows, strict=True)) if rows else (np.array([], int), *[np.empty(0)] * 3)
    )
    return Snapshot(t, np.arange(len(rows)), link.astype(np.int64), d, az, el, np.full(len(rows), 20.0))


def drive(filter_: PathParticles, vts: np.ndarray, links: list[int], snapshots: int, rng: np.random.Generator):
    """Drive straight at 1 m/s past `vts`, measured with small noise; return estimates and true poses."""
    poses, estimates = np.zeros((snapshots, 6)), []
    poses[:, 0] = 0.1 * np.arange(snapshots)
    for t in range(snapshots):
        z = predict(poses[t], vts) + rng.normal(size=(len(vts), 3)) * [0.3, 0.01, 0.01]
        rows = sorted((link, *z[i]) for i, link in enumerate(links))
        odometry = np.array([1.0, 0, 0, 0, 0, 0]) + rng.normal(size=6) * [0.03, 0, 0, 3e-3, 0, 0]
        estimates.append(filter_.step(0.1 if t else 0.0, odometry if t else np.zeros(6), make_snapshot(t, rows)))
    return estimates, poses


VTS = np.array([[60.0, 80.0, 20.0], [-40.0, 90.0, 25.0], [30.0, -70.0, 15.0], [120.0, 10.0, 30.0]])


def test_filter_maps_and_follows():
    filter_ = PathParticles(SMALL)
    filter_.start(make_setup(), np.random.default_rng(1))
    estimates, poses = drive(filter_, VTS, [0, 0, 1, 1], 150, np.random.default_rng(2))
    last = estimates[-1]
    assert np.hypot(*(last.pose[:2] - poses[-1, :2])) < 0.5
    assert sorted(last.vts.link) == [0, 0, 1, 1]
    gaps = np.linalg.norm(last.vts.position_m[:, None] - VTS[None], axis=2)
    assert sorted(gaps.argmin(axis=1)) == [0, 1, 2, 3]
    assert gaps.min(axis=1).max() < 3.0
    assert np.all(last.association >= 0)
    for matrix in [last.covariance[:2, :2], *last.vts.covariance]:
        assert np.all(np.linalg.eigvalsh(matrix) > 0)


def test_links_never_share_vts():
    """The same path in two links makes two VTs, one in each."""
    filter_ = PathParticles(SMALL)
    filter_.start(make_setup(), np.random.default_rng(1))
    estimates, _ = drive(filter_, VTS[[0, 0]], [0, 1], 30, np.random.default_rng(2))
    assert sorted(estimates[-1].vts.link) == [0, 1]


def test_unseen_vts_are_never_written():
    filter_ = PathParticles(replace_options(SMALL, effective_share=0.0))
    filter_.start(make_setup(offset_std=50.0), np.random.default_rng(1))
    drive(filter_, VTS, [0, 0, 1, 1], 20, np.random.default_rng(2))
    p = filter_._particles
    before = p.records[:, 1].copy()
    statuses = p.status[:, 1].copy()
    theta = p.columns(THETA, 1).copy()
    for t in range(20, 30):
        z = predict(np.array([0.1 * t, 0, 0, 0, 0, 0]), VTS[0])
        filter_.step(0.1, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(t, [(0, *z)]))
    assert np.array_equal(p.records[:, 1], before, equal_nan=True)  # memory never used may hold anything
    assert np.array_equal(p.status[:, 1], statuses)
    assert not np.array_equal(p.columns(THETA, 1), theta)


def replace_options(options: FastSlamOptions, **changes) -> FastSlamOptions:
    return FastSlamOptions(**{**options.model_dump(), **changes})


def test_resampling_copies_maps_and_shares_no_memory():
    filter_ = PathParticles(replace_options(SMALL, effective_share=0.0))
    filter_.start(make_setup(offset_std=50.0), np.random.default_rng(1))
    drive(filter_, VTS, [0, 0, 1, 1], 12, np.random.default_rng(2))
    p = filter_._particles
    rest = filter_.choice.parts, np.zeros(2, np.int64), np.zeros(3)
    maps = [map_of(p, i, *rest) for i in range(len(p))]
    poses = p.columns(POSE, 6)
    ancestors = np.sort(np.random.default_rng(4).choice(len(p), len(p)))
    ancestors[:40] = 3  # one particle has more children than its block has places
    ancestors.sort()
    chosen = select(p, ancestors)
    assert np.array_equal(np.sort(chosen.columns(POSE, 6)[:, 0]), np.sort(poses[ancestors, 0]))
    for i in range(len(chosen)):
        parent = np.flatnonzero(poses[:, 0] == chosen.columns(POSE, 6)[i, 0])[0]
        mine = map_of(chosen, i, *rest)
        assert set(zip(mine.id, mine.link, strict=True)) == set(zip(maps[parent].id, maps[parent].link, strict=True))
        order, theirs = np.argsort(mine.id), np.argsort(maps[parent].id)
        assert np.allclose(mine.position_m[order], maps[parent].position_m[theirs], atol=1e-9)
    twin = select(p, np.repeat(np.arange(2 * LANES)[:LANES], 1))
    assert len(twin) == LANES
    assert not np.shares_memory(twin.records, p.records)
    twin.records[:] = 0.0
    assert np.any(p.records[:, :, 0] != 0.0)


def test_offset_prior_is_kept_by_its_components():
    """Component means and their widths together have the prior's deviation, 150 m."""
    particles = draw(make_setup(offset_std=150.0), 4096, 20.0, 4, np.random.default_rng(0))
    means = particles.columns(THETA, 1)[:, 0]
    width = particles.columns(THETA + 3, 1)[:, 0]
    assert np.sqrt(means.var() + width.mean()) == pytest.approx(150.0, rel=0.02)
    assert np.allclose(width, 400.0)


def test_persisting_errors_count_once():
    options = FastSlamOptions(errors="counted", sharing="none")
    snapshot = make_snapshot(0, [(0, 100.0, 0.1, 0.1), (1, 100.1, 0.1, 0.1), (2, 100.0, 1.0, 0.1)])
    links = Links(np.zeros(3, np.int64), np.arange(3), np.zeros(3, np.int64))
    looks = Grouping(replace(make_setup(), links=links), options).looks(snapshot)
    q, z = np.tile([0.3, 1e-4, 1e-4], (3, 1)), np.array([[100.0, 0.1, 0.1], [100.1, 0.1, 0.1], [100.0, 1.0, 0.1]])
    assert list(count_sharers(z, np.arange(3), np.zeros(3, np.int64), q)) == [2, 2, 1]
    assert list(count_sharers(z, np.arange(3), np.array([0, 1, 0]), q)) == [1, 1, 1]
    assert list(count_sharers(z, np.array([0, 0, 1]), np.zeros(3, np.int64), q)) == [1, 1, 1]
    unknown = np.where([[False, True, False]] * 3, np.nan, z)
    assert list(count_sharers(unknown, np.arange(3), np.zeros(3, np.int64), q)) == [3, 3, 3]

    def values(turn: float, moved: float):
        return readings(looks, np.arange(3), options, turn, moved)

    fast, still = values(np.radians(90.0), 100.0), values(0.0, 0.0)
    tables = pack(fast.z, fast.single, fast.many, fast.fresh, fast.gap, fast.lack, np.ones(3, bool))
    single, many, fresh = (table[:, 5:8] for table in tables)
    assert np.all(many[:2, 1:] > single[:2, 1:])
    assert np.allclose(many[2, 1:], single[2, 1:])
    assert np.allclose(fresh, many)  # every error is drawn anew
    assert np.allclose(still.fresh, fast.fresh)
    assert np.all(still.many > 1e3 * still.fresh)


def test_doubles_become_one():
    """Two tracks of one VT: the one that is seen less often is given up; a neighbour five metres off stays."""

    def vts(merging: bool) -> int:
        f = PathParticles(SMALL.model_copy(update={"merging": merging, "gate": 400.0}))
        f.start(make_setup(offset_std=0.0), np.random.default_rng(0))
        rng, pose = np.random.default_rng(1), np.zeros(6)
        for t in range(100):
            pose = integrate_pose(pose, np.array([1.0, 0, 0, 0, 0, 0]), 0.1 if t else 0.0)
            seen = [*predict(pose, np.array([[60.0, 40.0, 10.0]]))[0] + [0.2, 0.005, 0.005] * rng.standard_normal(3)]
            other = [*predict(pose, np.array([[40.0, 60.0, 10.0]]))[0] + [0.2, 0.005, 0.005] * rng.standard_normal(3)]
            rows = [(0, *seen), (0, *other)]
            if t < 30:
                rows.append((0, seen[0] + 0.3, seen[1] + 0.002, seen[2]))
            estimate = f.step(0.1 if t else 0.0, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(t, rows))
        return len(estimate.vts.id)

    assert (vts(False), vts(True)) == (3, 2)


def hostile(rng: np.random.Generator, t: int) -> list[tuple[int, float, float, float]]:
    """Return awkward measurements: duplicates, straight overhead, azimuth at +-pi, very near, hundreds in one link."""
    kinds = [
        [(0, 50.0, np.pi, 0.0), (0, 50.0, -np.pi, 0.0), (0, 50.0, np.pi, 0.0)],
        [(0, 20.0, 0.3, np.pi / 2), (1, 20.0, -0.3, -np.pi / 2)],
        [(0, 0.01, 0.0, 0.0), (0, -5.0, 0.1, 0.0), (1, 1e5, 0.0, 0.0)],
        [
            (1, *row)
            for row in np.column_stack(
                [rng.uniform(10, 800, 200), rng.uniform(-3.1, 3.1, 200), rng.normal(0, 0.2, 200)]
            )
        ],
        [],
    ]
    return kinds[t % len(kinds)]


def test_awkward_measurements_leave_finite_estimates():
    filter_ = PathParticles(SMALL)
    filter_.start(make_setup(offset_std=150.0), np.random.default_rng(1))
    rng = np.random.default_rng(2)
    for t in range(60):
        snapshot = replace(
            make_snapshot(t, hostile(rng, t)), snr_db=np.full(len(hostile(rng, t)), (-40.0, 60.0)[t % 2])
        )
        estimate = filter_.step(0.1 if t else 0.0, np.array([1.0, 0, 0, 0.5, 0, 0]), snapshot)
        assert np.all(np.isfinite(estimate.pose))
        assert np.all(np.isfinite(estimate.covariance))
        assert np.all(np.isfinite(filter_._particles.log_weight))
        assert np.all(np.linalg.eigvalsh(estimate.covariance) > -1e-9)


def test_distance_alone_is_used_once_a_vt_is_known():
    filter_ = PathParticles(SMALL)
    filter_.start(make_setup(), np.random.default_rng(1))
    drive(filter_, VTS, [0, 0, 1, 1], 40, np.random.default_rng(2))
    for t in range(40, 60):
        z = predict(np.array([0.1 * t, 0, 0, 0, 0, 0]), VTS[0])
        estimate = filter_.step(0.1, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(t, [(0, z[0], np.nan, np.nan)]))
    assert estimate.association[0] >= 0
    assert abs(estimate.pose[0] - 5.9) < 0.5


def test_same_seed_same_answer():
    def once(seed: int) -> np.ndarray:
        filter_ = PathParticles(SMALL)
        filter_.start(make_setup(offset_std=150.0), np.random.default_rng(seed))
        estimates, _ = drive(filter_, VTS, [0, 0, 1, 1], 30, np.random.default_rng(2))
        return np.array([e.pose for e in estimates])

    assert np.array_equal(once(1), once(1))
    assert not np.array_equal(once(1), once(2))


def test_room_for_vts_grows_when_needed():
    """40 VTs in one link: lists of 24 grow, and the filter answers as with room from the start."""
    rows = [(0, 50.0 + 12.0 * i, -3.0 + 0.15 * i, 0.1) for i in range(40)]
    answers = []
    for capacity in (filter_module.CAPACITY, 128):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(filter_module, "CAPACITY", capacity)
            f = PathParticles(SMALL.model_copy(update={"vts_per_link": 200}))
            f.start(make_setup(offset_std=0.0), np.random.default_rng(0))
            for t in range(6):
                noisy = [(link, d + 0.1 * np.sin(7 * t + d), a, e) for link, d, a, e in rows]
                estimate = f.step(0.1 if t else 0.0, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(t, noisy))
            answers.append(estimate)
    assert len(answers[0].vts.id) == len(rows)
    assert np.array_equal(answers[0].pose, answers[1].pose)
    assert np.array_equal(answers[0].vts.position_m, answers[1].vts.position_m)


def test_the_cap_on_vts_holds():
    f = PathParticles(SMALL.model_copy(update={"vts_per_link": 10}))
    f.start(make_setup(offset_std=0.0), np.random.default_rng(0))
    rows = [(0, 50.0 + 12.0 * i, -3.0 + 0.15 * i, 0.1) for i in range(40)]
    for t in range(4):
        estimate = f.step(0.1 if t else 0.0, np.zeros(6), make_snapshot(t, rows))
    assert f._particles.order.shape[2] == 10
    assert len(estimate.vts.id) <= 10


def test_a_component_that_is_missing_leaves_the_rest_its_weight():
    """The score of distance and azimuth alone: their Gaussian against clutter of that density per (m rad)."""
    z = np.array([[300.0, 0.2, np.nan]])
    q = np.full((1, 3), 0.1)
    single, _, _ = pack(z, q, q, q, np.array([np.log(1.5)]), np.zeros(1), np.ones(1, bool))
    assert single[0, 11] == pytest.approx(0.5 * np.log(2 * np.pi) - np.log(1.5), rel=1e-6)
    assert list(single[0, 8:11]) == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("missing", ["distance_m", "azimuth_rad", "elevation_rad"])
def test_vts_are_found_though_a_component_is_never_measured(missing):
    """A drive round a corner past two VTs: 20 m ahead, then 20 m to the left."""
    vts = np.array([[30.0, 14.0, 4.0], [10.0, -25.0, 3.0]])
    options = replace_options(
        SMALL, particles=256, **NOTHING_PERSISTS | {"diffuse_m": 0.1, "diffuse_azimuth_deg": 0.3,
        "diffuse_elevation_deg": 0.71}, diffuse_scale_m=0.0,
    )  # fmt: skip
    filter_, rng = PathParticles(options), np.random.default_rng(3)
    filter_.start(make_setup(links=1), np.random.default_rng(1))
    pose = np.zeros(6)
    for t in range(240):
        velocity = np.array([2.0, 0, 0, np.pi / 4 if 100 <= t < 120 else 0.0, 0, 0])
        pose = integrate_pose(pose, velocity, 0.1) if t else pose
        noise = rng.normal(0.0, [0.1, 0.005, 0.005], (2, 3))
        snapshot = make_snapshot(t, [(0, *z) for z in [predict(pose, vt) for vt in vts] + noise])
        column = getattr(snapshot, missing)
        estimate = filter_.step(
            0.1 if t else 0.0, velocity, replace(snapshot, **{missing: np.full_like(column, np.nan)})
        )
    found = estimate.vts.position_m
    away = np.linalg.norm(found[None, :, :2] - vts[:, None, :2], axis=2).min(axis=1)
    assert np.all(away < 1.5)
    assert np.linalg.norm(estimate.pose[:2] - pose[:2]) < 0.5


def test_novelty_is_what_the_last_snapshot_has_not_shown():
    white = FastSlamOptions(errors="counted", diffuse_scale_m=0.0, calibration_scale_deg=0.0, roof_scale_deg=0.0)
    assert novelty(white, 0.0, 0.08) == pytest.approx(1.0)
    usual = FastSlamOptions(errors="counted")
    standing, straight, turning = (novelty(usual, *move) for move in ((0.0, 0.0), (0.0, 0.08), (0.02, 0.08)))
    assert 0.0 < standing < 1e-4 < straight < 0.02 < turning < 0.5
    # As an update of a lone path counts it, which is seen with one port.
    looks = Grouping(make_setup(1), usual).looks(make_snapshot(0, [(0, 150.0, 0.3, 0.1)]))
    read = readings(looks, np.zeros(1, np.int64), usual, 0.02, 0.08)
    assert np.mean(read.single / read.many) == pytest.approx(turning, rel=0.05)


@pytest.mark.parametrize(("lasts", "least", "most"), [(True, 1000.0, 1024.1), (False, 100.0, 700.0)])
def test_one_look_off_by_five_deviations_costs_few_particles(lasts, least, most):
    """Half of the particles have it within the gate: they must not gain what the others lose."""
    options = FastSlamOptions(
        errors="counted", particles=1024, effective_share=0.0, evidence_lasts=lasts, misfit_scale_s=0.0
    )
    tested, rng, vts = (
        PathParticles(options),
        np.random.default_rng(3),
        np.array([[60.0, 40.0, 10.0], [20.0, -50.0, 12.0]]),
    )
    tested.start(make_setup(1), rng)
    drive(tested, vts, [0, 0], 30, rng)
    p, (place, direction) = tested._particles, options.persisting
    deviation = np.sqrt(place[1] + direction[1])
    p.rows(POSE + 3, 1)[:] += deviation * np.linspace(-1.5, 1.5, 1024).reshape(p.log_weight.shape)[:, None]
    p.log_weight[:] = 0.0
    z = predict(np.array([2.9, 0, 0, 0, 0, 0]), vts)
    z[:, 1] += 5.8 * deviation
    tested.step(0.1, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(30, [(0, *row) for row in z]))
    associated = (tested._association[:, 0] >= 0).mean()
    assert 0.2 < associated < 0.8
    assert least < filter_module.normalised(tested._particles.log_weight)[2] < most
