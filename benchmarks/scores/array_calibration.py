"""The array's calibration as an estimator found it, beside the truth, over a grid of directions.

Source: docs/explanation/persisting-errors.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats
from cellslam.slam.model.calibration import Calibration

STEP_DEG = 3.0
OBSERVED = 0.99  # share of the variance that weights which were met have, at least: nearly all that reach a direction


@dataclass(frozen=True, repr=False)
class FieldMap(Described):
    """A field over `azimuth_rad` (A,) and `elevation_rad` (E,), body frame: `mean`, `std` and `truth` (E, A, 3) in m,
    rad, rad; NaN where no direction was met. `truth` is None where it is not known.
    """

    azimuth_rad: Floats
    elevation_rad: Floats
    mean: Floats
    std: Floats
    truth: Floats | None


def field_map(calibration: Calibration, provenance: Mapping[str, Any]) -> FieldMap:
    """Return the field where the drive met it, and as it was drawn where the provenance is that of a simulation."""
    azimuth = np.radians(np.arange(-180.0, 180.0, STEP_DEG))
    elevation = np.radians(np.arange(-90.0, 90.0 + STEP_DEG, STEP_DEG))
    directions = np.stack([part.ravel() for part in np.meshgrid(azimuth, elevation)], axis=1)
    unmet = calibration.met(directions) < OBSERVED

    def shaped(values: Floats) -> Floats:
        return np.asarray(np.where(unmet[:, None], np.nan, values).reshape(len(elevation), len(azimuth), 3))

    mean, std = calibration.at(directions)
    truth = drawn(provenance, directions)
    return FieldMap(azimuth, elevation, shaped(mean), shaped(std), None if truth is None else shaped(truth))


def drawn(provenance: Mapping[str, Any], directions: Floats) -> Floats | None:
    """Return the true field (n, 3), m and rad, at directions (n, 2) in rad; None where it was not drawn as one.

    Measured campaigns have none, nor has the signal-level front end, whose array errs port by port.
    """
    from cellslam.sim.lte.persisting_errors import calibration_at, draw_fields
    from cellslam.sim.lte.radio_config import RadioConfig
    from cellslam.sim.randomness import Stream, stream

    try:
        world, seed, trial = provenance["world"], provenance["seed"], provenance["trial"]
        radio, interval_s = RadioConfig(**world["radio"]), world["vehicle"]["snapshot_interval_s"]
    except (KeyError, TypeError, ValidationError):
        return None
    if radio.front_end == "signal":
        return None
    try:
        return calibration_at(draw_fields(radio, interval_s, stream(seed, trial, Stream.RECEIVER)), directions)
    except InputError:  # constants of a file that nobody asked for
        return None
