"""Traffic: the route and drive of our vehicle in, other vehicles as moving boxes out, and what they do to paths.

`draw_traffic` puts vehicles on the lanes beside the route and lets them drive (`driving`, by highway-env's models in
`driving_kernel`); `blocked_paths` says which path is blocked by which vehicle, `reflected_paths` finds the paths over
their sides (`obstacles`, `boxes_kernel`).
"""

from cellslam.sim.traffic.driving import draw_traffic
from cellslam.sim.traffic.obstacles import Blocked, blocked_paths, reflected_paths, reflecting_vehicle
from cellslam.sim.traffic.traffic import Traffic, traffic_of
from cellslam.sim.traffic.traffic_config import TrafficConfig

__all__ = [
    "Blocked", "Traffic", "TrafficConfig", "blocked_paths", "draw_traffic", "reflected_paths", "reflecting_vehicle",
    "traffic_of",
]  # fmt: skip
