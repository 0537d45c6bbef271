"""Traffic: the route and drive of our vehicle in, other vehicles as moving boxes out, and what paths they block.

`draw_traffic` puts vehicles on the lanes beside the route and lets them drive (`driving`, by highway-env's models in
`driving_kernel`); `reflected_paths` finds the paths over their sides (`reflecting`, `reflecting_kernel`),
`blocked_paths` says which path is blocked by which vehicle (`blocking`, `blocking_kernel`).
"""

from cellslam.sim.traffic.blocking import Blocked, blocked_paths
from cellslam.sim.traffic.driving import draw_traffic
from cellslam.sim.traffic.reflecting import reflected_paths, reflecting_vehicle
from cellslam.sim.traffic.traffic import Traffic, traffic_of
from cellslam.sim.traffic.traffic_config import TrafficConfig

__all__ = [
    "Blocked",
    "Traffic",
    "TrafficConfig",
    "blocked_paths",
    "draw_traffic",
    "reflected_paths",
    "reflecting_vehicle",
    "traffic_of",
]
