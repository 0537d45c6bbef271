"""From a scenario to the recording of one trial: over our own rays, or over paths traced or measured elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.scenarios.loading import load
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.sim.frames import held, mean_velocity
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Recording
from cellslam.sim.vehicle import Drive
from cellslam.sim.world import draw_reception, recorded
from cellslam.sim.world import simulate as simulate_world

if TYPE_CHECKING:
    from cellslam.sim.rays.exchange import Traced
FASTEST_MPS = 70.0
HEADING_OVER_M = 0.1
CARRIER_SHARE = 0.01


def simulate(
    scenario: str | Path | Scenario,
    seed: int = 0,
    trial: int = 0,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress = silent,
    place: int | None = None,
) -> Recording:
    """Return the recording of one trial, whose provenance holds the resolved scenario, root seed and trial.

    `scenario`: a preset's name, a .toml path, or a Scenario (then without overrides); `overrides` by dotted key.
    `place`: trial whose city, route and sites it has (None: its own). Raises InputError for a wrong request, and where
    the world cannot be made.
    """
    chosen = scenario_of(scenario, overrides)
    recording = simulate_world(chosen.world, seed, trial, progress, place)
    tables = {key: table for key, table in chosen.resolved.items() if key != "map"}  # it has no part in a recording
    return replace(recording, provenance={"scenario": tables, **recording.provenance})


def scenario_of(scenario: str | Path | Scenario, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Return a scenario that is loaded, or load it with overrides. Raises InputError where both are given."""
    if not isinstance(scenario, Scenario):
        return load(scenario, overrides)
    if overrides:
        raise InputError("overrides cannot change a Scenario that is already loaded: give its name or path")
    return scenario


def simulate_paths(
    scenario: Scenario, traced: Traced, name: str, seed: int = 0, trial: int = 0, progress: Progress = silent
) -> Recording:
    """Return the recording of a drive from receiver to receiver, a snapshot each, over the paths called `name`.

    Radio, cells, odometry and snapshot interval are the scenario's; its sites stand where the transmitters of the paths
    do, in their order. The vehicle is level and heads where it goes. Raises InputError where both do not fit.
    """
    _check(scenario, traced, name)
    positions = [tuple(place) for place in traced.transmitters_m.tolist()]
    sites = tuple(s.model_copy(update={"position_m": p}) for s, p in zip(scenario.sites, positions, strict=True))
    config = scenario.world.model_copy(update={"sites": sites})
    driven = drive_through(traced.receivers_m, config.vehicle.snapshot_interval_s)
    reception = draw_reception(config, seed, trial, traced.transmitters_m, driven)
    odometry, streams = reception.odometry(), reception.streams()
    found = reception.detect(
        traced.paths, driven.poses, driven.velocity, held(odometry.velocity), streams, progress=progress
    )
    recording, _ = recorded(reception, odometry, found, traced.paths, reception.reports())
    return replace(recording, provenance={"description": f"paths of {name}", **recording.provenance})


def drive_through(places_m: Floats, interval_s: float) -> Drive:
    """Return the level drive over places (T, 3) in m, one each interval, heading where it goes."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places_m[:, :2], axis=0).T))])
    if travelled[-1] < HEADING_OVER_M:
        raise InputError("the receivers are one place: give those of a drive, in order")
    # Over some distance, as places have errors; so a vehicle that stands looks as it came and will go.
    last = len(travelled) - 1
    ahead = np.minimum(np.searchsorted(travelled, travelled + HEADING_OVER_M), last)
    behind = np.maximum(np.searchsorted(travelled, travelled - HEADING_OVER_M, side="right") - 1, 0)
    yaw = np.arctan2(*(places_m[ahead] - places_m[behind])[:, 1::-1].T)
    poses = np.column_stack([places_m, yaw, np.zeros((len(yaw), 2))])
    lasts = np.full(len(yaw) - 1, interval_s)
    velocity = mean_velocity(poses[:-1], poses[1:], lasts)
    return Drive(interval_s * np.arange(len(yaw), dtype=np.float64), poses, np.vstack([velocity, velocity[-1:]]))


def along(traced: Traced, places_m: Floats) -> Traced:
    """Return the paths of the receivers nearest to places (T, 3) in m, in their order; repeated ones once."""
    from scipy.spatial import cKDTree

    nearest = np.asarray(cKDTree(traced.receivers_m).query(places_m)[1])
    chosen = nearest[np.append(True, np.diff(nearest) != 0)]
    begin = np.searchsorted(traced.paths.receiver, chosen)
    count = np.searchsorted(traced.paths.receiver, chosen, side="right") - begin
    rows = np.repeat(begin - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(count.sum())
    paths = replace(traced.paths.take(rows), receiver=np.repeat(np.arange(len(chosen)), count))
    return replace(traced, paths=paths, receivers_m=traced.receivers_m[chosen])


def _check(scenario: Scenario, traced: Traced, name: str) -> None:
    if len(traced.transmitters_m) != len(scenario.sites):
        names = ", ".join(site.name for site in scenario.sites)
        raise InputError(
            f"{name} has {len(traced.transmitters_m)} transmitters, the scenario {len(scenario.sites)} sites "
            f"({names}): give a scenario with as many, in the same order"
        )
    if len(traced.receivers_m) < 2:
        raise InputError(f"{name} has {len(traced.receivers_m)} receivers: give those of a drive, two at least")
    if scenario.radio.late_probability > 0.0:
        raise InputError(
            f"{name} says nothing of what was between its receivers, where late snapshots are measured: "
            "--set radio.late_probability=0"
        )
    carrier = scenario.radio.carrier_hz
    if traced.carrier_hz is not None and abs(traced.carrier_hz - carrier) > CARRIER_SHARE * carrier:
        raise InputError(
            f"{name} was traced at {traced.carrier_hz:g} Hz, the scenario receives at {carrier:g} Hz: "
            f"--set radio.carrier_hz={traced.carrier_hz:g}"
        )
    interval = scenario.vehicle.snapshot_interval_s
    step = np.linalg.norm(np.diff(traced.receivers_m, axis=0), axis=1)
    if step.max() > FASTEST_MPS * interval:
        row = int(np.argmax(step))
        raise InputError(
            f"{name}: receiver {row + 1} is {step[row]:.1f} m from the one before it, {step[row] / interval:.0f} m/s: "
            "they must be a drive, in order; choose one through them with --along, or set vehicle.snapshot_interval_s"
        )
