"""fit-noise finds what the maker of the data put in."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from cellslam.recordings import Campaign, OdometryTable, ReferenceTable, build
from cellslam.recordings.fitting.fit_noise import UNKNOWN, initial_options
from cellslam.recordings.fitting.fit_sizes import BURSTS, Learnt, learn, toml
from cellslam.recordings.fitting.fit_tracks import tracks_of
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.recording import OdometryModel, Recording
from cellslam.slam import registry
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from tests.command_line import Run

STD_M, STD_RAD, UNIT_M, DETECTED, FALSE = 0.2, np.radians(0.8), 0.3, 0.7, 0.5
SPEED_NOISE, TURN_NOISE, TURN_BIAS = 0.15, 0.01, 0.012
AREA_M = 60.0


@pytest.fixture(scope="module")
def world() -> Recording:
    return winding(3000)


def winding(count: int) -> Recording:
    """Sources in a plane, seen from a winding drive; white noise that falls with the SNR, misses, clutter."""
    rng, dt = np.random.default_rng(11), 0.2
    times = dt * np.arange(count)
    turn = 0.25 * np.sin(0.05 * times)
    heading = np.concatenate([[0.0], np.cumsum(turn[1:] * dt)])
    middle = heading[:-1] + 0.5 * turn[1:] * dt
    steps = 1.5 * dt * np.column_stack([np.cos(middle), np.sin(middle)])
    place = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    sources = np.array([[20.0 * i, s * (12.0 + 5.0 * (i % 4))] for i in range(-3, 49) for s in (-1, 1)])
    rows = []
    for t in range(count):
        d = sources - place[t]
        reach = np.hypot(*d.T)
        near = np.flatnonzero((reach < 45.0) & (rng.random(len(d)) < DETECTED))
        snr_db = rng.uniform(-5.0, 25.0, len(near))
        std = np.sqrt(STD_M**2 + UNIT_M**2 * 10 ** (-snr_db / 10))
        azimuth = np.arctan2(d[near, 1], d[near, 0]) - heading[t] + STD_RAD * rng.standard_normal(len(near))
        distance = reach[near] + std * rng.standard_normal(len(near))
        rows.append(np.column_stack([np.full(len(near), times[t]), distance, azimuth, snr_db]))
        false = rng.poisson(FALSE)
        anywhere = rng.uniform(5, 5 + AREA_M, false), rng.uniform(-np.pi, np.pi, false)
        rows.append(np.column_stack([np.full(false, times[t]), *anywhere, np.full(false, 10.0)]))
    table = np.concatenate(rows)
    speed = np.full(count, 1.5) + SPEED_NOISE / np.sqrt(dt) * rng.standard_normal(count)
    rate = turn + TURN_BIAS + TURN_NOISE / np.sqrt(dt) * rng.standard_normal(count)
    return build(
        Campaign(
            table[:, 0],
            {
                "distance_m": table[:, 1],
                "azimuth_rad": np.arctan2(np.sin(table[:, 2]), np.cos(table[:, 2])),
                "snr_db": table[:, 3],
            },
            OdometryTable(times, {"u_x": speed, "u_psi": rate}, "before"),
            start_pose=(0.0,) * 6,
            snapshots_s=times,
            plane=True,
            reference=ReferenceTable(times[::10], place[::10]),
        )
    )


def test_what_was_put_in_is_found(world: Recording) -> None:
    found = initial_options(world)
    assert found["noise_floor_m"] == pytest.approx(STD_M, rel=0.2)
    assert found["noise_unit_snr_m"] == pytest.approx(UNIT_M, rel=0.25)
    assert found["noise_floor_azimuth_deg"] == pytest.approx(np.degrees(STD_RAD), rel=0.2)
    assert found["detection_probability"] == pytest.approx(DETECTED, abs=0.06)
    volume = 2 * np.pi * 0.9 * AREA_M * np.sqrt(2 * np.pi) * np.radians(0.5)
    assert found["clutter_density"] == pytest.approx(FALSE / volume, rel=0.5)


def with_sheet(world: Recording, speed: float, turn: float) -> Recording:
    density = np.array([speed, 0.0, 0.0, turn, 0.0, 0.0])
    return dataclasses.replace(world, odometry_model=dataclasses.replace(world.odometry_model, noise_density=density))


@pytest.mark.slow
def test_odometry_and_noise_are_learnt_whatever_the_sheet_says(world: Recording) -> None:
    """The data sheet is five times too wide in speed and five times too tight in turning."""
    learnt = learn(with_sheet(world, 5.0 * SPEED_NOISE, 0.2 * TURN_NOISE), None)
    speed, turn = learnt.odometry_model.noise_density[[0, 3]] / BURSTS
    assert speed == pytest.approx(SPEED_NOISE, rel=0.3)
    assert turn == pytest.approx(TURN_NOISE, rel=0.3)
    assert TURN_BIAS / 2.0 < learnt.odometry_model.bias[3] < BURSTS * TURN_BIAS
    assert learnt.options["noise_floor_m"] == pytest.approx(STD_M, rel=0.3)
    assert learnt.options["noise_floor_azimuth_deg"] == pytest.approx(np.degrees(STD_RAD), rel=0.3)


@pytest.mark.slow
def test_one_command_learns_and_replays(cellslam: Run) -> None:
    """Without an option a measured recording is fitted first; the tables that this leaves can be given again."""
    mistold = with_sheet(winding(1000), 5.0 * SPEED_NOISE, 0.2 * TURN_NOISE)
    mistold.save("a.h5")
    density = learn(mistold, None).odometry_model.noise_density
    words = ("replay", "a.h5", "--estimator", "ekf-slam", "--no-figures")
    assert "noise of the odometry's speed: 0." in cellslam(*words, "--out", "out").err
    fitted = Path("out/fit.toml")
    tables = tomllib.loads(fitted.read_text("utf-8"))
    assert set(tables) == {"estimator", "noise"} and set(tables["noise"]) == {"u_x", "u_psi"}
    assert tables["noise"]["u_x"]["noise_density"] == pytest.approx(density[0], rel=1e-3)
    again = cellslam(*words, "--out", "again", "--options", fitted)
    assert again.status == 0 and "as assumed" not in again.err
    ends = [np.loadtxt(f"{folder}/trajectory-ekf-slam.tum")[-1, 1:3] for folder in ("out", "again")]
    np.testing.assert_allclose(ends[0], ends[1], atol=0.1)


def test_what_was_learnt_is_given_to_every_map_builder() -> None:
    """`replay --options fit.toml` tells an estimator what plain `replay` tells it."""
    values = {"detection_probability": 0.61, "clutter_density": 0.17, "noise_floor_m": 0.23}
    learnt = Learnt(values, OdometryModel(*np.zeros((4, 6))), {}, None)
    names = [entry.name for entry in registry.BUILT_IN]
    given = resolve(tomllib.loads(toml(Path("a.h5"), learnt))["estimator"], names, ())
    options = {r.name: r.options for r in given if isinstance(r.options, MeasurementOptions)}
    assert {"ekf-slam", "fastslam", "bp-slam", "phd-slam"} <= set(options)
    for own in options.values():
        assert {key: getattr(own, key) for key in values} == values


def test_too_little_to_learn_is_told(thin: Recording, cellslam: Run) -> None:
    thin.save("a.h5")
    words = ("replay", "a.h5", "--estimator", "dead-reckoning", "--no-figures")
    alone, fitted = cellslam(*words), cellslam(*words, "--fit")
    assert alone.status == fitted.status == 0
    assert "learnt" not in alone.err and "nothing learnt from" in fitted.err
    alone = cellslam("fit-noise", "a.h5")
    assert alone.status == 2 and "tracks of three detections" in alone.err


def test_errors_that_persist_are_told_from_white_ones(world: Recording) -> None:
    """What was put in is white; then the same errors of place are added to all of a track, over 3 m of the way."""
    white = initial_options(world)
    assert white["diffuse_m"] < 0.6 * STD_M
    way = np.concatenate([[0.0], np.cumsum(np.diff(world.time_s) * np.abs(world.odometry[1:, 0]))])
    rng = np.random.default_rng(2)
    knots = np.arange(0.0, way[-1] + 40.0, 1.0)
    smooth = np.exp(-0.5 * ((knots[:, None] - knots) / (3.0 / np.sqrt(2.0))) ** 2)
    m = world.measurements
    # Paths are told apart by where they lie, to the left or right, near or far: 40 functions of the way.
    place = rng.standard_normal((40, len(knots))) @ (smooth / np.sqrt((smooth**2).sum(axis=1, keepdims=True))).T
    kind = np.maximum(tracks_of(world).track, 0) % 40
    extra = place[kind, np.minimum(way[m.snapshot].astype(int), len(knots) - 1)]
    found = initial_options(
        dataclasses.replace(world, measurements=dataclasses.replace(m, distance_m=m.distance_m + 0.5 * extra))
    )
    assert np.hypot(found["diffuse_m"], found["calibration_m"]) == pytest.approx(0.5, rel=0.4)
    assert found["diffuse_scale_m"] > 1.0


def test_simulated_cellular_noise_at_unit_snr() -> None:
    """The statistical front end's thermal part is 0.0405 m at 0 dB; its other errors are not white and are kept
    apart.
    """
    found = initial_options(Recording.load(str(files("cellslam.slam.conformance").joinpath("conformance_drive.h5"))))
    assert found["noise_unit_snr_m"] == pytest.approx(0.0405, rel=0.25)
    assert found["calibration_m"] > found["noise_floor_m"]
    assert 0.7 < found["detection_probability"] < 0.95


@pytest.fixture(scope="module")
def thin(world: Recording, take: Callable[..., Recording]) -> Recording:
    """One measurement of five hundred."""
    return take(world, np.arange(len(world.measurements)) % 500 == 0)


@pytest.mark.parametrize("columns", [("distance_m",), ("azimuth_rad",)])
def test_delays_or_angles_alone_give_white_errors(
    columns: tuple[str, ...], world: Recording, strip: Callable[..., Recording]
) -> None:
    found = initial_options(strip(world, *columns))
    measured, std = ("azimuth_deg", np.degrees(STD_RAD)) if columns == ("distance_m",) else ("m", STD_M)
    (stripped,) = {"azimuth_deg", "m"} - {measured}
    assert found[f"noise_floor_{measured}"] == pytest.approx(std, rel=0.5)
    assert found[f"noise_floor_{stripped}"] == UNKNOWN[f"noise_floor_{stripped}"]
    assert found[f"calibration_{measured}"] == 0.0 and 0.3 < found["detection_probability"] < 0.99
