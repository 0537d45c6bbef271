"""The start pose that a reference gives, and how uncertain it is."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.recordings import Campaign, OdometryTable, ReferenceTable, build
from cellslam.recordings.importing.odometry import motion_of
from cellslam.recordings.importing.start_pose import YAW_STD, start_from_reference
from cellslam.sim.frames import followed, integrate_pose
from cellslam.sim.recording import Floats, Reference
from cellslam.slam.api import setup_of

STEP_S, COUNT, DRIVES = 0.5, 60, 25


def fitted(rng: np.random.Generator, fix_std_m: float) -> tuple[Floats, Floats]:
    """Return error of the start (x, y, yaw) and its deviations, of a drive whose wheels and gyros have a bias, scales
    and noise, and whose fixes err for some 20 s."""
    speed = np.zeros((COUNT, 6))
    speed[:, 0], speed[:, 3] = 2.0, 0.2 * np.sin(0.1 * STEP_S * np.arange(COUNT) + rng.uniform(0.0, 6.0))
    poses, lasting = np.zeros((COUNT, 6)), fix_std_m * rng.standard_normal(2)
    poses[0, 3], kept = rng.uniform(-3.0, 3.0), np.exp(-STEP_S / 20.0)
    fixes = np.full((COUNT, 3), np.nan)
    for t in range(COUNT):
        if t:
            poses[t] = integrate_pose(poses[t - 1], speed[t], STEP_S)
            lasting = kept * lasting + fix_std_m * np.sqrt(1.0 - kept**2) * rng.standard_normal(2)
        fixes[t, :2] = poses[t, :2] + lasting
    noise = np.array([0.1, 0.01]) / np.sqrt(STEP_S) * rng.standard_normal((COUNT, 2))
    bias, scale = np.array([0.0, 0.01]) * rng.standard_normal(2), 0.05 * rng.standard_normal(2)
    u = speed[:, [0, 3]] * (1.0 + scale) + bias + noise
    times, nothing = STEP_S * np.arange(COUNT), np.full(COUNT, np.nan)
    motion = motion_of(OdometryTable(times, {"u_x": u[:, 0], "u_psi": u[:, 1]}, "before"))
    pose, std = start_from_reference(motion, Reference(times, fixes, nothing, nothing), 0.0)
    error = pose - poses[0]
    return error[[0, 1, 3]], std[[0, 1, 3]]


@pytest.mark.parametrize("fix_std_m", [1.0, 0.02])
def test_a_start_that_is_fitted_is_as_uncertain_as_it_errs(fix_std_m: float) -> None:
    """Whether the fixes come from satellites or from a total station, of which the reference says nothing."""
    rng = np.random.default_rng(7)
    error, std = (np.array(part) for part in zip(*(fitted(rng, fix_std_m) for _ in range(DRIVES)), strict=True))
    off = np.sqrt(np.mean((error / std) ** 2, axis=0))
    assert (off > 0.4).all() and (off < 2.0).all(), off


def campaign(**start: tuple[float, ...]) -> Campaign:
    """A drive along the x axis with a reference that reports its heading."""
    t, zero = 0.1 * np.arange(50), np.zeros(50)
    reference = ReferenceTable(t, np.column_stack([3.0 * t, zero]), zero, 0.05)
    return Campaign(t, {"distance_m": 50.0 + t}, OdometryTable(t, {"u_x": zero + 3.0}), reference=reference, **start)


def test_a_start_is_as_sure_as_the_reference_unless_it_is_given() -> None:
    assert build(campaign()).start_std == pytest.approx([0.05, 0.05, 0.0, YAW_STD, 0.0, 0.0])
    assert not build(campaign(start_pose=(0.0,) * 6)).start_std.any()
    heading = (np.nan, np.nan, np.nan, 0.3, np.nan, np.nan)
    assert build(campaign(start_std=heading)).start_std == pytest.approx([0.05, 0.05, 0.0, 0.3, 0.0, 0.0])


def test_how_the_vehicle_moved_before_its_first_command_is_not_known() -> None:
    """Commands that change at random, from any row on: how far off the turn is that is followed from there alone."""
    rng = np.random.default_rng(2)
    t, commands = 0.1 * np.arange(2000), np.zeros((2000, 6))
    commands[:, 3] = np.repeat(0.5 * rng.standard_normal(200), 10)
    dt_s = np.diff(t, prepend=0.0)
    whole = followed(commands, dt_s, 0.4)[0]
    rows = np.arange(50, 1900, 7)
    off = [
        0.1 * (followed(commands[k : k + 50], dt_s[k : k + 50], 0.4)[0] - whole[k : k + 50])[1:, 3].sum() for k in rows
    ]
    wheels = OdometryTable(t, {"u_x": np.ones(2000), "u_psi": commands[:, 3]}, "before", time_constant_s=0.4)
    setup = setup_of(build(Campaign(t, {"distance_m": 50.0 + t}, wheels, start_pose=(0.0,) * 6)))
    assert setup.start_std[3] == pytest.approx(np.sqrt(np.mean(np.square(off))), rel=0.15)
    assert setup.start_std[0] == pytest.approx(0.0, abs=0.05) and not setup.start_std[[1, 2, 4, 5]].any()
