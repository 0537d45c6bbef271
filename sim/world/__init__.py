"""The world of one trial: a city with sites and a vehicle, and what its receiver measures there.

`prepare` draws a trial's world, `World.measure` is the primitive (one pose), `simulate` a whole drive as a recording
(`drive_to_recording`).
"""

from cellslam.sim.world.drive_to_recording import known_of, recorded, simulate, versions, virtual_transmitters
from cellslam.sim.world.world import (
    KEPT_SCENES,
    World,
    WorldConfig,
    city_and_route,
    city_rng,
    draw_reception,
    path_columns,
    prepare,
)

__all__ = [
    "KEPT_SCENES", "World", "WorldConfig", "city_and_route", "city_rng", "draw_reception", "known_of", "path_columns",
    "prepare", "recorded", "simulate", "versions", "virtual_transmitters",
]  # fmt: skip
