"""Recordings: the one data contract, its checks, its HDF5 file.

`tables` has the data classes, `contract` the Recording made of them, `checks` what it must fulfil; `hdf5` is the file,
`hdf5_layout` its columns, `damage` whether it is safe to read.
"""

from cellslam.sim.recording.contract import Recording
from cellslam.sim.recording.hdf5_layout import COMPONENTS, SCHEMA_VERSION
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
