"""Maps that are remembered: the prior against one filter over both drives, the file, drives with a map, wrong maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Links, OdometryModel, Recording, Sites
from cellslam.slam.api import Estimate, Setup
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.map_check import MapCheck
from cellslam.slam.joint.map_states import WIDENED, Observed, Remembered, map_after, standing
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.state.layout import ENTRY, UNSEEN, VT, block_of, one_of
from cellslam.slam.model.measurement_model import jacobians
from cellslam.slam.model.vt_map import VtMap, factored, joined
from tests.sealing import resealed
from tests.slam.driving import driven

RNG = np.random.default_rng(5)
ONE_LINK, SITES = Links(*(np.zeros(1, np.int64) for _ in range(3))), ("A",)
NOWHERE = np.zeros((0, ENTRY))


def some_map(count: int, rng: np.random.Generator) -> tuple[VtMap, Floats]:
    """Return a map with a joint covariance that is drawn, and that covariance (3 V, 3 V)."""
    root = 0.3 * rng.standard_normal((3 * count, 3 * count))
    own, common = factored(root.reshape(count, 3, -1), np.zeros((count, 3, 3)))
    place = 20.0 * np.arange(count)
    whole = np.zeros(count, np.int64)
    return VtMap(
        np.array(["A"] * count), whole, whole, rng.uniform(60.0, 200.0, (count, 3)),
        np.stack([place, 0.0 * place, 0.0 * place], axis=1), own, common,
        np.stack([place, 0.0 * place, place, 0.0 * place], axis=1).reshape(-1, 2, 2), whole + 9, whole,
    ), root @ root.T  # fmt: skip


def corrected(x: Floats, p: Floats, h: Floats, e: Floats, q: float) -> None:
    """Update mean and covariance, in place, by an innovation e of h x with noise of variance q."""
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + q * np.eye(len(h)))
    x += gain @ e
    p -= gain @ h @ p


def test_two_drives_are_one_joint_filter() -> None:
    known, joint = some_map(5, np.random.default_rng(1))
    setup = Setup(ONE_LINK, Sites(SITES, *np.zeros((2, 1))), OdometryModel(*np.zeros((4, 6))), *np.zeros((2, 6)),
                  map=known)  # fmt: skip
    mixture = new_mixture(setup, core_of(setup, NO_ERRORS), NO_ERRORS, np.zeros((1, 1)), np.zeros(1))
    mixture.reserve(60, 5)
    f, remembered, seen = one_of(mixture.arrays, 0), Remembered(known, ONE_LINK, SITES, 1), dict[int, Floats]()
    position = known.position_m.ravel().copy()
    # VTs 0 and 1 are met and seen, then 2, which learns of it; 3 comes into reach and is not seen, 4 never comes.
    for enter, measurements in (([0, 1], [0, 1]), ([2], [2, 0]), ([3], [])):
        remembered.put_in(f, block_of(mixture.blocks, 0), np.array(enter), 0)
        for vt in measurements:
            at = f.vts.state[np.flatnonzero(f.vts.slots[: f.count[0], 3] == 1 + vt)[0], VT : VT + 3]
            a, n, cartesian = RNG.standard_normal((2, 3)), int(f.size[0]), slice(3 * vt, 3 * vt + 3)
            # So small that a linear world is what is left.
            e, h, full = 1e-10 * RNG.standard_normal(2), np.zeros((2, n)), np.zeros((2, 15))
            by = jacobians(standing(known.anchor_m[[vt]]), known.position_m[[vt]])[0][0]
            h[:, at], full[:, cartesian] = a, a @ by
            corrected(f.x[:n], f.p[:n, :n], h, e, 1e-4)
            corrected(position, joint, full, e, 1e-4)
            f.vts.slots[np.flatnonzero(f.vts.slots[: f.count[0], 3] == 1 + vt)[0], UNSEEN] = 0
            seen[1 + vt] = known.seen_m[vt]
    after = map_after(f, NOWHERE, Observed(ONE_LINK, SITES, seen), remembered, 3)
    np.testing.assert_allclose(after.position_m.ravel() - known.position_m.ravel(),
                               position - known.position_m.ravel(), atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(after.joint_covariance_m2 / WIDENED, joint, atol=1e-9 * np.abs(joint).max())


def test_what_is_compressed_keeps_each_position_and_what_is_common() -> None:
    rng = np.random.default_rng(2)
    shared, alone = np.tile(rng.standard_normal((1, 3, 4)), (60, 1, 1)), 0.1 * rng.standard_normal((60, 3, 180))
    joint = np.concatenate([shared, alone], axis=2)
    own, common = factored(joint, np.zeros((60, 3, 3)), 20)
    assert common.shape == (60, 3, 20)
    whole = joint @ np.swapaxes(joint, 1, 2)
    np.testing.assert_allclose(own + common @ np.swapaxes(common, 1, 2), whole, atol=1e-12)
    mean = np.tile(np.eye(3), (1, 60)) / 60.0  # the error that all have together
    flat, kept = joint.reshape(180, -1), common.reshape(180, -1)
    exact = mean @ flat @ flat.T @ mean.T
    found = mean @ kept @ kept.T @ mean.T + sum(own) / 3600.0
    np.testing.assert_allclose(np.diag(found), np.diag(exact), rtol=0.02)


def test_a_map_is_the_same_from_its_file(tmp_path: Path) -> None:
    known = replace(some_map(4, RNG)[0], provenance={"estimator": "ekf-slam"})
    known.save(tmp_path / "map.h5")
    again = VtMap.load(tmp_path / "map.h5")
    for name in ("site", "cell_id", "position_m", "anchor_m", "own_m2", "common_m", "seen_m", "hits", "missed"):
        np.testing.assert_array_equal(getattr(again, name), getattr(known, name))
    assert again.provenance == known.provenance


def broken(name: str, value: Any) -> Callable[[h5py.File], None]:
    """Return what replaces an array of a file, or takes it away."""

    def change(file: h5py.File) -> None:
        del file[name]
        if value is not None:
            file[name] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        broken("own_m2", np.tile(-np.eye(3), (4, 1, 1))), broken("position_m", np.full((4, 3), np.nan)),
        broken("hits", None), broken("seen_m", np.zeros((1, 2, 2))),
        lambda file: file.attrs.update(format="cellslam calibration"),
    ],
    ids=["negative", "not finite", "no hits", "another shape", "another format"],
)  # fmt: skip
def test_a_broken_file_is_one_line(change: Callable[[h5py.File], None], tmp_path: Path) -> None:
    path = tmp_path / "map.h5"
    some_map(4, RNG)[0].save(path)
    with resealed(path) as file:
        change(file)
    with pytest.raises(InputError, match="not a map") as raised:
        VtMap.load(path)
    assert "\n" not in str(raised.value) and str(path) in str(raised.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: {"anchor_m": m.position_m}, "a VT's position equals its anchor"),
        (lambda m: {"hits": m.hits - 99}, "write whole numbers from 0 on"),
        (lambda m: {"own_m2": m.own_m2 + np.triu(np.ones((3, 3)), 1)}, "that of VT 0 is not symmetric"),
        (lambda m: {"own_m2": m.own_m2 - np.eye(3)}, "that of VT 0 has a negative eigenvalue"),
    ],
)
def test_a_map_that_cannot_be_says_why(change: Callable[[VtMap], dict[str, Any]], says: str) -> None:
    made = some_map(1, np.random.default_rng(2))[0]
    with pytest.raises(InputError, match=says):
        replace(made, **change(made)).check()


def test_no_file_and_a_truncated_one_say_what_writes_one(tmp_path: Path) -> None:
    path = tmp_path / "map.h5"
    with pytest.raises(InputError, match="no such file; 'cellslam run --save-map FILE' writes one"):
        VtMap.load(path)
    some_map(4, RNG)[0].save(path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="truncated"):
        VtMap.load(path)


def mapped(recording: Recording, known: VtMap | None, snapshots: int = 400) -> tuple[EkfSlam, float]:
    """Return ekf-slam after a drive, and the root mean square of its horizontal error in m."""
    estimator = EkfSlam()
    poses = np.array([answer.pose for answer in driven(estimator, recording, snapshots, known=known)])
    assert recording.truth is not None
    off = poses[:, :2] - recording.truth.poses[: len(poses), :2]
    return estimator, float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def drives() -> list[Recording]:
    return [simulate("tiny", seed, trial, {"radio.clock_offset_std_m": 30.0}) for seed in (40, 44) for trial in (0, 1)]


@pytest.fixture(scope="module")
def maps(drives: list[Recording]) -> list[VtMap]:
    return [learnt for first in drives[::2] if (learnt := mapped(first, None)[0].vt_map()) is not None]


@pytest.fixture(scope="module")
def without(drives: list[Recording]) -> list[float]:
    """The errors (m) of the second drives by filters without a map."""
    return [mapped(second, None)[1] for second in drives[1::2]]


@pytest.mark.slow
@pytest.mark.parametrize("sequence", [0, 1])
def test_a_drive_with_a_map_is_better(
    sequence: int, drives: list[Recording], maps: list[VtMap], without: list[float]
) -> None:
    second, known = drives[2 * sequence + 1], maps[sequence]
    estimator, with_map = mapped(second, known)
    after = estimator.vt_map()
    assert with_map < 0.8 * without[sequence] and estimator.remarks() == [] and after is not None
    assert 1 <= len(after) <= len(known) + 3 and (after.hits.max() > known.hits.max())
    own, before = (np.sqrt(np.trace(m.covariance_m2, axis1=1, axis2=2)) for m in (after, known))
    assert np.median(own) < np.median(before)


@pytest.mark.slow
def test_clock_offsets_are_found_at_once_with_a_map(drives: list[Recording], maps: list[VtMap]) -> None:
    assert mapped(drives[1], maps[0], 40)[0].resolved
    assert not mapped(drives[1], None, 40)[0].resolved


@pytest.mark.slow
@pytest.mark.parametrize("shift_m", [(5.0, 0.0, 0.0), (-3.0, 4.0, 0.0), (0.0, 400.0, 0.0)])
def test_a_wrong_map_is_noticed(
    shift_m: tuple[float, float, float], drives: list[Recording], maps: list[VtMap], without: list[float]
) -> None:
    by = np.array(shift_m)
    near = maps[0].seen_m if by[1] > 100.0 else maps[0].seen_m + by[:2]
    wrong = replace(maps[0], position_m=maps[0].position_m + by, anchor_m=maps[0].anchor_m + by, seen_m=near)
    estimator, error = mapped(drives[1], wrong)
    assert any("the map does not fit" in line for line in estimator.remarks())
    assert error < 1.2 * without[0]


@pytest.mark.parametrize(
    ("snapshots", "accepted", "rejected"),
    [
        ([(60, True)] * 25, True, ""),
        ([(40, True)] * 25, False, "40% of the measurements are of its VTs"),
        # While a vehicle stands, the likeliest offset may be a wrong one: no measurement is of the map's VTs.
        ([(0, False)] * 25, False, ""),
        ([(0, False)] * 25 + [(100, True)], True, ""),
    ],
)
def test_a_map_that_explains_few_measurements_is_rejected_once_clock_offsets_are_known(
    snapshots: list[tuple[int, bool]], accepted: bool, rejected: str
) -> None:
    """Of 100 measurements a snapshot so many are of the map's VTs, whose identities are 1000 and more."""
    check = MapCheck(range(1000, 2000))
    for ours, resolved in snapshots:
        same = Estimate(np.zeros(6), np.eye(6), np.arange(100) + 1000 * (np.arange(100) < ours))
        check.take(same, same, np.zeros(2), resolved=resolved, resolved_without=resolved)
    assert check.accepted == accepted and bool(check.rejected) == bool(rejected) and rejected in check.rejected


@pytest.mark.slow
def test_what_is_gone_is_forgotten(drives: list[Recording], maps: list[VtMap]) -> None:
    known = maps[0]
    gone = replace(known.part(slice(0, 1)), position_m=known.position_m[:1] + np.array([0.0, 0.0, 300.0]))
    both = joined([known, gone])
    once = mapped(drives[1], both)[0].vt_map()
    assert once is not None and once.missed.max() == 1
    twice = mapped(drives[1], once)[0].vt_map()
    assert twice is not None and twice.missed.max() == 0 and len(twice) == len(once) - 1


@pytest.mark.slow
def test_vts_out_of_reach_are_not_touched(drives: list[Recording], maps: list[VtMap]) -> None:
    known = maps[0]
    far = replace(known, seen_m=known.seen_m + 1e4)
    large = joined([known, *[far] * 50])
    (small_one, small), (large_one, same) = (mapped(drives[1], m, 60) for m in (known, large))
    assert same == pytest.approx(small, rel=1e-9)
    states = [one._joint.arrays.size[0, 0] for one in (small_one, large_one) if one._joint is not None]
    assert len(states) == 2 and states[0] == states[1]


def test_a_map_may_be_empty(tmp_path: Path) -> None:
    none = some_map(2, RNG)[0].part(slice(0, 0))
    for empty in (none, replace(none, common_m=np.zeros((0, 3, 0)))):
        empty.compressed().save(tmp_path / "map.h5")
        assert len(VtMap.load(tmp_path / "map.h5")) == 0
