"""Known worlds of others, and the figures that were published: anchors and VTs, a trajectory and noise, without a city,
or a preset.

In: a name, root seed and trial; out: the recording of a run, and the estimators with options that are to be compared.
"""

from __future__ import annotations

from importlib import import_module

from cellslam.scenarios.known_worlds.known_world import KnownWorld
from cellslam.sim.errors import unknown_name

NAMES = {"bp-slam-testbed": "bp_slam_testbed", "paper": "paper", "phd-slam-3": "phd_slam_3"}


def known_world(name: str) -> KnownWorld:
    """Return the known world of that name. Raises InputError."""
    if name not in NAMES:
        raise unknown_name("known world", name, NAMES)
    found: KnownWorld = import_module(f"{__name__}.{NAMES[name]}").WORLD
    return found
