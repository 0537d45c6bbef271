"""Measured campaigns: import, inspection, export, and the noise that a recording itself shows.

`Campaign` and `build` are what a Python adapter for `cellslam import` needs.
"""

from cellslam.recordings.importing.campaign import Campaign, ReferenceTable, build
from cellslam.recordings.importing.odometry import OdometryTable

__all__ = ["Campaign", "OdometryTable", "ReferenceTable", "build"]
