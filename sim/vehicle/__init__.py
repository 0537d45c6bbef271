"""The vehicle: its route on street lanes, its true motion, its odometry."""

from cellslam.sim.vehicle.drive import Drive, drive
from cellslam.sim.vehicle.odometry import Odometry, measure_odometry, odometry_model
from cellslam.sim.vehicle.route import Route, plan_route
from cellslam.sim.vehicle.vehicle_config import OdometryConfig, VehicleConfig

__all__ = [
    "Drive",
    "Odometry",
    "OdometryConfig",
    "Route",
    "VehicleConfig",
    "drive",
    "measure_odometry",
    "odometry_model",
    "plan_route",
]
