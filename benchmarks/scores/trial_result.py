"""What one estimator answered on one recording: the input of scores, figures and files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellslam.sim.described import POSE_COLUMNS, Described, dataframe
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate, WallEstimate
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.vt_map import VtMap

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class TrialResult(Described):
    """The estimates of one drive; T snapshots, M measurements, S sites, in the order of the recording.

    `poses` (T, 6) and `covariances` (T, 6, 6): the answer that is scored. `smoothed`: the poses are those of
    `finish()`, which used the whole drive, while the covariances are still those of the snapshots.
    `association` (M,): VT id per measurement, -1 for none, as answered in its own snapshot. `clock_offset_m` and
    `clock_offset_variance_m2` (T, S). `vts`, `walls`: the last ones reported.
    `calibration`: of the array, at the end; `vt_map`: what is left for the next drive. None: the estimator does not
    give this.
    `remarks`: what the estimator says of the drive in words. `oracle`: it was shown the truth. `estimate_seconds`,
    `peak_memory_mb`: what it took; NaN: not known.
    """

    estimator: str
    poses: Floats
    covariances: Floats
    association: Ints | None = None
    clock_offset_m: Floats | None = None
    clock_offset_variance_m2: Floats | None = None
    vts: VtEstimate | None = None
    walls: WallEstimate | None = None
    calibration: Calibration | None = None
    vt_map: VtMap | None = None
    remarks: tuple[str, ...] = ()
    smoothed: bool = False
    oracle: bool = False
    estimate_seconds: float = float("nan")
    peak_memory_mb: float = float("nan")

    def to_dataframe(self) -> pd.DataFrame:
        """Return a pandas table, a row a snapshot: x_m, y_m, z_m, yaw_rad, pitch_rad, roll_rad, position_std_m."""
        return dataframe(dict(zip(POSE_COLUMNS, self.poses.T, strict=True)) | {"position_std_m": self.position_std_m})

    @property
    def position_std_m(self) -> Floats:
        """Claimed horizontal standard deviation (T,) in m: root of the trace of the x-y covariance."""
        return np.asarray(np.sqrt(self.covariances[:, 0, 0] + self.covariances[:, 1, 1]))
