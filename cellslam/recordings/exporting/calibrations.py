"""The array's calibration as a CSV table over directions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.array_calibration import field_map
from cellslam.slam.model.calibration import COMPONENTS, Calibration


def write_csv(calibration: Calibration, provenance: Mapping[str, Any], file: Path) -> None:
    """Write a row for each direction that was met: azimuth and elevation in degrees, in the body frame, and of each
    component the error's mean, its deviation and, where it is known, the truth, in m or degrees."""
    import pandas as pd

    field = field_map(calibration, provenance)
    azimuth, elevation = np.meshgrid(np.degrees(field.azimuth_rad), np.degrees(field.elevation_rad))
    met = np.isfinite(field.mean[..., 0])
    columns = {"azimuth_deg": azimuth[met], "elevation_deg": elevation[met]}
    for name in calibration.components:
        c = COMPONENTS.index(name)
        factor, unit = (1.0, "m") if name == "distance" else (180.0 / np.pi, "deg")
        parts = {"mean": field.mean, "std": field.std} | ({} if field.truth is None else {"truth": field.truth})
        columns |= {f"{name}_error_{part}_{unit}": factor * values[met][:, c] for part, values in parts.items()}
    pd.DataFrame(columns).to_csv(file, index=False, float_format="%.6g")
