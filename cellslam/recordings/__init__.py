"""Measured campaigns: import, inspection, export, and the noise that a recording itself shows.

`importing` makes a `Campaign` of a folder of tables, and `build`s the recording of it; an adapter makes one of files in
a layout of its own, with nothing but what stands here. `inspection` finds mistakes in a recording, `fitting` the sizes
of its errors; `exporting` writes it, and what estimators make of it, for other tools.
"""

from cellslam.recordings.importing.campaign import Campaign, ReferenceTable, build
from cellslam.recordings.importing.odometry import OdometryTable

__all__ = ["Campaign", "OdometryTable", "ReferenceTable", "build"]
