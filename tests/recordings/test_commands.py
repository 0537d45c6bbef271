"""Odometry that is what the vehicle was commanded, which it follows with a time constant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellslam.recordings import Campaign, OdometryTable, build
from cellslam.recordings.fitting.assumptions import changed_sheet
from cellslam.recordings.fitting.fit_sizes import in_words, learn, toml
from cellslam.sim.errors import InputError
from cellslam.sim.frames import followed
from cellslam.sim.recording import Recording
from cellslam.slam.api import odometry_of
from tests.recordings.mistaken_worlds import STEP_S, campaign, paths, way_through

FOLLOWS_S = 0.5


def commanded(seed: int) -> Campaign:
    """A hall of 60 x 40 m, walked slowly, by odometry of what a vehicle was commanded to that follows late."""
    rng = np.random.default_rng(seed)
    corners = np.column_stack([rng.uniform(5, 55, 9), rng.uniform(5, 35, 9)])
    vehicle = way_through(corners, 1.2, 0.8, 120.0)
    sources = np.column_stack([rng.uniform(-30, 90, 9), rng.uniform(-30, 70, 9)])
    seen = paths(vehicle, np.arange(0, len(vehicle), 10), sources, (0.1, np.radians(1.0)), 120.0, 0.8, 0.5, rng)
    ahead = np.append(np.hypot(*np.diff(vehicle[:, :2], axis=0).T), 0.0) / STEP_S
    turn = np.append(np.diff(vehicle[:, 2]), 0.0) / STEP_S
    ahead, turn = (u + FOLLOWS_S * np.gradient(u, STEP_S) for u in (ahead, turn))
    wheels = OdometryTable(STEP_S * np.arange(len(vehicle)), {"u_x": ahead, "u_psi": turn}, valid_s=np.inf)
    return campaign(vehicle, seen, wheels, (0.0, 0.0), (10, 0.02, True), rng)


def test_a_vehicle_follows_as_a_system_of_the_first_order() -> None:
    rng = np.random.default_rng(1)
    dt_s, commands = np.append(0.0, rng.uniform(0.05, 1.0, 8)), rng.standard_normal((9, 6))
    now, found = commands[1], followed(commands, dt_s, 0.3)[0]
    for t in range(1, 9):

        def motion(_: float, state: np.ndarray, t: int = t) -> np.ndarray:
            return np.append(state[6:], (commands[t] - state[6:]) / 0.3)

        end = solve_ivp(motion, (0.0, dt_s[t]), np.append(np.zeros(6), now), rtol=1e-9, atol=1e-9).y[:, -1]
        assert found[t] == pytest.approx(end[:6] / dt_s[t], abs=1e-6)
        now = end[6:]
    assert found[0] == pytest.approx(commands[0])


def test_whether_odometry_is_commanded_is_kept(tmp_path: Path) -> None:
    given = commanded(3)
    assert given.odometry is not None
    assert build(given).odometry_model.time_constant_s == 0.0
    measured = replace(given.odometry, valid_s=None, time_constant_s=None)
    assert build(replace(given, odometry=measured)).odometry_model.time_constant_s is None
    known = build(replace(given, odometry=replace(given.odometry, time_constant_s=FOLLOWS_S)))
    known.save(tmp_path / "hall.h5")
    assert Recording.load(tmp_path / "hall.h5").odometry_model.time_constant_s == FOLLOWS_S
    assert not np.allclose(odometry_of(known), odometry_of(build(given)))


def test_an_option_changes_the_time_constant() -> None:
    sheet = build(commanded(3)).odometry_model
    assert changed_sheet(sheet, {"noise.commands.time_constant_s": 0.3}).time_constant_s == 0.3
    with pytest.raises(InputError, match=r"noise\.commands\.time_constant_s.*-1"):
        changed_sheet(sheet, {"noise.commands.time_constant_s": -1.0})
    with pytest.raises(InputError, match="did you mean 'commands'"):
        changed_sheet(sheet, {"noise.command.time_constant_s": 0.3})


@pytest.mark.slow
def test_the_time_constant_is_learnt() -> None:
    learnt = learn(build(commanded(3)), None)
    found = learnt.odometry_model.time_constant_s
    assert found is not None and 0.7 * FOLLOWS_S < found < 1.4 * FOLLOWS_S
    assert any("follows its commands" in line for line in in_words(learnt))
    assert "[noise.commands]\ntime_constant_s" in toml(Path("hall.h5"), learnt)


@pytest.mark.slow
def test_a_vehicle_that_follows_at_once_has_no_time_constant() -> None:
    given = commanded(4)
    assert given.odometry is not None
    wheels = build(given)
    at_once = replace(wheels, odometry=followed(wheels.odometry, np.diff(wheels.time_s, prepend=0.0), FOLLOWS_S)[0])
    learnt = learn(at_once, None)
    assert not learnt.odometry_model.time_constant_s
