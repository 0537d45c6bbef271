"""Measured campaigns: import, inspection, export, and the noise that a recording itself shows.

`Campaign` and `build` are what a Python adapter for `cellslam import` needs.
"""

from cellslam.benchmarks.recordings.campaign import Campaign, OdometryTable, ReferenceTable, build

__all__ = ["Campaign", "OdometryTable", "ReferenceTable", "build"]
