"""From a scenario to the recording of one trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellslam.scenarios.loading import load
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording


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
    from cellslam.sim.world import simulate as simulate_world

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
