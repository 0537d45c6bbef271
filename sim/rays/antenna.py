"""The pattern of a base station's sector antenna.

Source: 3GPP TR 36.814, Table A.2.1.1-2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.city.city import Floats
from cellslam.sim.frames import wrap_angle

FRONT_TO_BACK_DB, SIDELOBE_DB = 25.0, 20.0
AZIMUTH_WIDTH_RAD, ELEVATION_WIDTH_RAD = np.radians(70.0), np.radians(10.0)  # at 3 dB


def sector_gain_db(
    azimuth_offset_rad: ArrayLike, elevation_rad: ArrayLike, tilt_rad: ArrayLike, peak_dbi: float = 15.0
) -> Floats:
    """Return the gain (...,) in dBi of a sector antenna, broadcast over its arguments.

    Azimuth from boresight; departure elevation, up positive; down-tilt, down positive: all in rad.
    """
    azimuth = wrap_angle(azimuth_offset_rad)
    below = -np.asarray(elevation_rad, np.float64) - np.asarray(tilt_rad, np.float64)
    horizontal = np.minimum(12.0 * (azimuth / AZIMUTH_WIDTH_RAD) ** 2, FRONT_TO_BACK_DB)
    vertical = np.minimum(12.0 * (below / ELEVATION_WIDTH_RAD) ** 2, SIDELOBE_DB)
    return np.asarray(peak_dbi - np.minimum(horizontal + vertical, FRONT_TO_BACK_DB), np.float64)
