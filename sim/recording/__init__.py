"""Recordings: the one data contract, its checks, its HDF5 file.

`tables` has the data classes, `columns` what each column holds, `contract` the Recording made of them and its checks;
`hdf5` is the file, `damage` whether it is safe to read.
"""

from cellslam.sim.recording.columns import COMPONENTS, SCHEMA_VERSION
from cellslam.sim.recording.contract import Recording
from cellslam.sim.recording.tables import (
    CLOCK_PRIOR,
    ClockSteps,
    Floats,
    Ints,
    Links,
    Measurements,
    OdometryModel,
    Reference,
    Sites,
    Truth,
    Vehicles,
    VirtualTransmitters,
)

__all__ = [
    "CLOCK_PRIOR",
    "COMPONENTS",
    "SCHEMA_VERSION",
    "ClockSteps",
    "Floats",
    "Ints",
    "Links",
    "Measurements",
    "OdometryModel",
    "Recording",
    "Reference",
    "Sites",
    "Truth",
    "Vehicles",
    "VirtualTransmitters",
]
