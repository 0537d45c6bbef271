"""The vehicle: streets of a city in, its route, its true poses and velocities, its odometry out.

`plan_route` takes waypoints or walks the streets (`route`, `street_walk`); `drive` follows the route at speeds from
`speed_profile`; `measure_odometry` adds the sensors' errors, `with_faults` what goes wrong now and then (`odometry`).
"""

from cellslam.sim.vehicle.drive import Drive, drive
from cellslam.sim.vehicle.odometry import Odometry, measure_odometry, odometry_model, with_faults
from cellslam.sim.vehicle.route import Route, plan_route
from cellslam.sim.vehicle.vehicle_config import OdometryConfig, VehicleConfig

__all__ = [
    "Drive", "Odometry", "OdometryConfig", "Route", "VehicleConfig", "drive", "measure_odometry", "odometry_model",
    "plan_route", "with_faults",
]  # fmt: skip
