"""Measured campaigns: import, inspection, export, and the noise that a recording itself shows.

`Campaign` and `build` are what a Python adapter for `cellslam import` needs.
"""

from cellslam.recordings.importing.campaign import Campaign, OdometryTable, ReferenceTable
from cellslam.recordings.importing.campaign_to_recording import build

__all__ = ["Campaign", "OdometryTable", "ReferenceTable", "build"]
