"""Named sets of drives to learn from: what they are. `reading` has their drives, `windows` batches of parts of them.

A set is a folder: a packed recording a drive, by split, in some sets with its raw responses beside it; `index.csv`, a
row a file; and the card, `croissant.json`. The drives of the split `test` have no truth; `test-truth` has them again,
with it. A set never changes: what would change its drives is another set, under another name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from cellslam.scenarios.loading import load
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import unknown_name

INDEX, CARD = "index.csv", "croissant.json"
RESPONSES = "-responses"  # of the names of files with raw responses, and of their split in the index
SPLITS = ("train", "validation", "test")
TRUTH = "test-truth"
# A minute each, with a cheap gyro: with that of the presets odometry alone is nearly as good as the bound in a minute.
_SHORT = {
    "vehicle.distance_m": 60.0, "vehicle.duration_s": 60.0, "vehicle.stops": 1, "odometry.gyro_bias_deg_per_s": 0.5,
}  # fmt: skip


@dataclass(frozen=True)
class SetDefinition:
    """A set by its name: a preset with overrides, and of each split how many drives, trials from 0 of root `seeds`."""

    name: str
    title: str
    preset: str
    overrides: Mapping[str, Any]
    drives: Mapping[str, int]
    seeds: Mapping[str, int]
    published: str
    responses: bool = False  # whether each drive has its raw array responses beside it

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of all drives."""
        return load(self.preset, self.overrides)

    @property
    def places(self) -> list[tuple[str, int]]:
        """Split and trial of every drive, in their order."""
        return [(split, trial) for split in SPLITS for trial in range(self.drives[split])]

    @property
    def digest(self) -> str:
        """SHA-256 of what the drives follow from: all that is not a default, how many there are, and their seeds."""
        world = self.scenario.world.model_dump(mode="json", exclude_defaults=True)
        content = [self.name, world, dict(self.drives), dict(self.seeds)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _set(
    name: str, title: str, preset: str, overrides: Mapping[str, Any], drives: tuple[int, int, int],
    responses: bool = False,
) -> SetDefinition:  # fmt: skip
    seeds = {split: 68_000 + place for place, split in enumerate(SPLITS)}
    counts = dict(zip(SPLITS, drives, strict=True))
    return SetDefinition(name, title, preset, {**_SHORT, **overrides}, counts, seeds, "2026-11-30", responses)


SETS = {
    one.name: one
    for one in (
        _set(
            "learn-lund", "a minute each on other streets of one city", "lund-530", {"vehicle.waypoints_m": None},
            (800, 100, 100),
        ),
        _set(
            "learn-cities", "a minute each in another open city: those of validation and test are in no other split",
            "anywhere", {}, (800, 100, 100),
        ),
        _set(
            "learn-signal", "raw array responses on one street: other clocks, other traffic, a snapshot a second",
            "lund-530", {
                "radio.front_end": "signal", "vehicle.snapshot_interval_s": 1.0, "traffic.vehicles_per_km": 20.0,
            }, (24, 4, 4), responses=True,
        ),
    )
}  # fmt: skip


def set_definition(name: str) -> SetDefinition:
    """Return the set of that name. Raises InputError."""
    if name not in SETS:
        raise unknown_name("set", name, tuple(SETS))
    return SETS[name]
