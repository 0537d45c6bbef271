"""The one data contract: a recording, checked as it is made, kept as one HDF5 file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cellslam.sim.recording.checks import check
from cellslam.sim.recording.tables import RecordingData


@dataclass(frozen=True, repr=False)
class Recording(RecordingData):
    """A drive as it was measured, whole and consistent: see `RecordingData` for its columns.

    Raises InputError, naming table, column and row, where a column breaks the contract.
    """

    def __post_init__(self) -> None:
        check(self)

    def save(self, path: str | Path) -> None:
        """Write the recording to one HDF5 file, atomically. Raises InputError when that is impossible."""
        from cellslam.sim.recording.hdf5 import save

        save(self, Path(path))

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read and check a recording. Raises InputError naming file, table and row of what is wrong."""
        from cellslam.sim.recording.hdf5 import load

        return load(Path(path), Recording)
