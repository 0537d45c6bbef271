"""The array's calibration: the next drive begins with what a drive leaves of it, in the filter and in the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.scores.array_calibration import drawn, field_map
from cellslam.benchmarks.trials.answers import calibration_of, decoded, encoded, plain_calibration
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import setup_of
from cellslam.slam.joint.calibration_states import found
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.state.layout import one_of
from cellslam.slam.joint.state.states_kernel import leave
from cellslam.slam.model.calibration import Calibration
from tests.sealing import resealed
from tests.slam.driving import driven, go_on

ONE_CAR: dict[str, Any] = {"radio.array_seed": 5, "radio.clock_offset_std_m": 0.0}
SNAPSHOTS = 160
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def drives() -> tuple[Recording, Recording]:
    """Two drives of one car."""
    first, second = (simulate("tiny", 71, trial, ONE_CAR) for trial in (0, 1))
    return first, second


@pytest.fixture(scope="module")
def learnt(drives: tuple[Recording, Recording]) -> EkfSlam:
    """A filter after the first drive."""
    estimator = EkfSlam()
    driven(estimator, drives[0], SNAPSHOTS)
    return estimator


@pytest.fixture
def calibration(learnt: EkfSlam) -> Calibration:
    known = learnt.calibration()
    assert known is not None
    return known


def poses(estimator: EkfSlam, recording: Recording) -> Floats:
    """Return poses (T, 6) of an estimator that has been started."""
    return np.array([answer.pose for answer in go_on(estimator, recording, SNAPSHOTS)])


def assuming(tmp_path: Path, known: Calibration, **options: Any) -> EkfSlamOptions:
    known.save(tmp_path / "car.h5")
    return EkfSlamOptions(calibration_file=str(tmp_path / "car.h5"), **options)


def test_second_drive_is_that_of_a_joint_filter_which_goes_on(
    drives: tuple[Recording, Recording], learnt: EkfSlam, calibration: Calibration, tmp_path: Path
) -> None:
    goes_on, begins, again = EkfSlam(), EkfSlam(assuming(tmp_path, calibration)), EkfSlam()
    for estimator in (goes_on, begins, again):
        estimator.start(setup_of(drives[1]), RNG)
    assert learnt._joint is not None and goes_on._joint is not None
    # The filter of the first drive loses map and roof, and is put to the start of the second.
    whole, fresh = learnt._joint, goes_on._joint
    kept = whole.arrays._replace(**{name: getattr(whole.arrays, name).copy() for name in ("x", "p", "owner", "size")})
    fields = whole.arrays.fields._replace(state=whole.arrays.fields.state.copy())
    kept = kept._replace(fields=fields, vts=whole.arrays.vts._replace(state=whole.arrays.vts.state.copy()))
    f, core = one_of(kept, 0), whole.core.size
    weights = 3 * calibration.grid.cells
    for place in range(int(f.size[0]) - 1, core - 1, -1):
        if not 0 <= f.owner[place] < weights:
            leave(f, place)
    f.p[:core], f.p[:, :core] = 0.0, 0.0
    f.x[:core], f.p[:core, :core] = fresh.arrays.x[0, :core], fresh.arrays.p[0, :core, :core]
    fresh.arrays = fresh.arrays._replace(x=kept.x, p=kept.p, owner=kept.owner, size=kept.size, fields=fields)
    joint = poses(goes_on, drives[1])
    np.testing.assert_allclose(poses(begins, drives[1]), joint, rtol=0.0, atol=1e-8)
    assert np.abs(poses(again, drives[1]) - joint).max() > 1e-3


def test_what_is_found_is_nearer_to_the_truth_than_the_prior(
    drives: tuple[Recording, Recording], calibration: Calibration
) -> None:
    field = field_map(calibration, drives[0].provenance)
    assert field.truth is not None
    there = np.isfinite(field.mean[..., 0])
    apart = (field.mean - field.truth)[there] / field.std[there]
    assert (field.std[there] <= calibration.size * (1.0 + 1e-9)).all() and field.std[there].min() < calibration.size[0]
    assert 0.4 < np.sqrt(np.mean(apart**2)) < 1.8


def test_without_a_field_that_was_drawn_there_is_no_truth() -> None:
    signal = load("tiny", {"radio.front_end": "signal"}).world.model_dump(mode="json")
    other = {"world": signal | {"radio": {"load": 7}}, "seed": 0, "trial": 0}
    lost = signal | {"radio": {"statistics_file": "gone.json"}}  # whoever shows a file of others has not asked for it
    for provenance in ({}, other, *({"world": world, "seed": 0, "trial": 0} for world in (signal, lost))):
        assert drawn(provenance, np.zeros((2, 2))) is None


def test_file_and_message_give_back_what_was_given(calibration: Calibration, tmp_path: Path) -> None:
    given = replace(calibration, provenance={"estimator": "ekf-slam"})
    given.save(tmp_path / "car.h5")
    read = Calibration.load(tmp_path / "car.h5")
    sent = calibration_of(decoded(encoded({}, plain_calibration(given)))[1])
    assert sent is not None and read.provenance == given.provenance
    for other in (read, sent):
        for name in ("size", "component", "cell", "mean", "covariance"):
            np.testing.assert_array_equal(getattr(other, name), getattr(given, name))
        assert (other.scale_rad, other.spacing, other.reach) == (given.scale_rad, given.spacing, given.reach)
    assert [path.name for path in tmp_path.iterdir()] == ["car.h5"]


def test_filters_of_the_start_begin_with_what_is_known(
    drives: tuple[Recording, Recording], calibration: Calibration, tmp_path: Path
) -> None:
    setup = setup_of(drives[1])
    wide = replace(setup, sites=replace(setup.sites, clock_offset_std_m=np.full(len(setup.sites), 150.0)))
    estimator = EkfSlam(assuming(tmp_path, calibration))
    estimator.start(wide, RNG)
    assert estimator._start is not None and len(estimator._start.mixtures) == len(setup.sites)
    for mixture in estimator._start.mixtures:
        again = found(mixture, estimator._errors)
        order = np.lexsort((again.cell, again.component)), np.lexsort((calibration.cell, calibration.component))
        np.testing.assert_allclose(again.mean[order[0]], calibration.mean[order[1]], rtol=1e-12)


def test_bound_of_a_calibrated_array_is_lower(drives: tuple[Recording, Recording]) -> None:
    free, known = bound(drives[1]).position_rmse_m, bound(drives[1], calibrated=True).position_rmse_m
    assert 0.3 * free < known < 0.999 * free


def test_what_cannot_be_used_is_refused(calibration: Calibration, tmp_path: Path) -> None:
    file, no = tmp_path / "car.h5", tmp_path / "no.h5"
    calibration.save(file)

    def said(**options: Any) -> str:
        with pytest.raises(InputError) as raised:
            resolve({"ekf-slam": {"calibration_file": str(file), **options}}, ("ekf-slam",))
        return str(raised.value)

    assert "set calibration_scale_deg = 15" in said(calibration_scale_deg=20.0)
    assert "a calibration of distance, azimuth, elevation" in said(calibration_m=0.0)
    assert "no such file" in said(calibration_file=str(no))
    no.write_text("nothing")
    assert "not a calibration" in said(calibration_file=str(no))
    with resealed(file) as changed:
        changed["covariance"][0, 0] = -1.0
    assert "negative eigenvalue" in said()
    with resealed(file) as changed:
        del changed["mean"]
    assert "not a calibration" in said()
