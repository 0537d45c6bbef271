"""A commanded vehicle: the time constant with which it follows is learnt where there is one, and none where not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings import build
from cellslam.recordings.fitting.assumptions import changed_sheet
from cellslam.recordings.fitting.fit_sizes import in_words, learn, toml
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.errors import InputError
from cellslam.sim.frames import followed
from cellslam.sim.recording import COMPONENTS, Recording
from cellslam.slam.api import odometry_of
from tests.recordings.mistaken_worlds import STEP_S, Floats, campaign, odometry, paths, way_through


def commanded(tau_s: float, seed: int) -> Recording:
    """A minute in a hall with ten VTs, each 0.2 s; odometry are the commands of a driver, each for 0.2 s, which the
    vehicle follows as a filter of the first order."""
    rng = np.random.default_rng(seed)
    corners = np.column_stack([rng.uniform(5, 55, 9), rng.uniform(5, 35, 9)])
    wheels = odometry(way_through(corners, 1.5, 0.7, 60.0), 4, (0.02, 0.01, 0.0, 0.0), rng)
    vehicle = followed_by_euler(np.column_stack([np.asarray(u) for u in wheels.components.values()]), tau_s)
    sources = np.column_stack([rng.uniform(-30, 90, 10), rng.uniform(-30, 70, 10)])
    rows = np.arange(0, len(vehicle), 4)
    seen = paths(vehicle, rows, sources, (0.3, np.radians(2.0)), 120.0, 0.8, 0.5, rng)
    return build(campaign(vehicle, seen, wheels, (0.0, 0.0), (20, 0.02, True), rng))


def followed_by_euler(commands: Floats, tau_s: float) -> Floats:
    """Poses (N, 3) each 50 ms by commands (n, 2) of speed and yaw rate that hold for 0.2 s, in steps of 1 ms."""
    fine, (v, w), (x, y, heading) = 50, commands[0], (30.0, 20.0, 0.0)
    poses = [(x, y, heading)]
    for k in range(4 * fine * len(commands)):
        u = commands[k // (4 * fine)]
        step = min(STEP_S / fine / tau_s, 1.0) if tau_s else 1.0
        v, w = v + step * (u[0] - v), w + step * (u[1] - w)
        x, y = x + v * np.cos(heading) * STEP_S / fine, y + v * np.sin(heading) * STEP_S / fine
        heading += w * STEP_S / fine
        if k % fine == fine - 1:
            poses.append((x, y, heading))
    return np.array(poses)


def test_a_step_is_followed_as_its_closed_form() -> None:
    """From 1 to 3 at t = 0: v = 3 - 2 exp(-t / tau), distance 3 t - 2 tau (1 - exp(-t / tau)), at any intervals."""
    dt_s = np.array([0.0, 0.5, 0.1, 0.3, 0.02, 1.2])
    u = np.repeat([[0.0], [1.0], [3.0], [3.0], [3.0], [3.0]], 6, axis=1)
    tau = np.array([0.4, 0.0, 0.0, 0.2, 0.0, 0.0])
    found, t = followed(u, dt_s, tau), np.cumsum(dt_s[2:])
    for i in (0, 3):
        distance = 3.0 * t - 2.0 * tau[i] * (1.0 - np.exp(-t / tau[i]))
        assert np.cumsum(found[2:, i] * dt_s[2:]) == pytest.approx(distance) and found[1, i] == pytest.approx(1.0)
    assert (found[:, [1, 2, 4, 5]] == u[:, [1, 2, 4, 5]]).all() and (followed(u[:1], dt_s[:1], tau) == u[:1]).all()


def test_a_time_constant_is_a_part_of_the_data_sheet(tmp_path: Path) -> None:
    """Of the recording's file, of what `--set` changes, and of what estimators are given."""
    recording = commanded(0.4, 1)
    sheet = changed_sheet(recording.odometry_model, {"noise.u_psi.time_constant_s": 0.4})
    stated = replace(recording, odometry_model=sheet)
    stated.save(tmp_path / "a.h5")
    again = Recording.load(tmp_path / "a.h5")
    assert again.odometry_model.time_constant_s.tolist() == [0.0, 0.0, 0.0, 0.4, 0.0, 0.0]
    turned, plain = odometry_of(again), odometry_of(recording)
    assert (turned[:, 0] == plain[:, 0]).all() and np.abs(turned[:, 3] - plain[:, 3]).max() > 0.05
    with pytest.raises(InputError, match=r"time_constant_s.*is not a duration"):
        replace(recording, odometry_model=replace(sheet, time_constant_s=-sheet.time_constant_s))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_time_constant_of_a_commanded_vehicle_is_learnt(seed: int) -> None:
    recording = commanded(0.4, seed)
    learnt = learn(recording, None)
    assert learnt.odometry_model.time_constant_s == pytest.approx(np.full(6, 0.4), rel=0.3)
    assert learnt.following is not None and learnt.following.sure
    assert in_words(learnt)[0].startswith("the vehicle follows its odometry with a time constant of 0.")
    text = toml(Path("a.h5"), learnt)
    assert text.count("time_constant_s = ") == len(COMPONENTS)
    alone = resolve({}, ("dead-reckoning",), ())[0]
    plain, own = (
        score(drive, estimate(drive, alone, np.random.default_rng(0)), None)["position_rmse_m"]
        for drive in (recording, replace(recording, odometry_model=learnt.odometry_model))
    )
    assert own < 0.3 * plain


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_vehicle_that_goes_as_it_is_measured_follows_nothing(seed: int) -> None:
    learnt = learn(commanded(0.0, seed), None)
    assert not learnt.odometry_model.time_constant_s.any() and learnt.following is None
    assert "follows" not in "".join(in_words(learnt))
