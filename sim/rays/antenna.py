"""Antenna patterns: the base station's sector antenna and the element of the vehicle's array.

Source: 3GPP TR 36.814, Table A.2.1.1-2 (sector antenna) and TR 38.901, Table 7.3-1 (element).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.city.city import Floats
from cellslam.sim.frames import wrap_angle


def sector_gain_db(
    azimuth_offset_rad: ArrayLike,
    elevation_rad: ArrayLike,
    tilt_rad: ArrayLike,
    peak_dbi: float = 15.0,
    azimuth_width_rad: float = np.radians(70.0),
    elevation_width_rad: float = np.radians(10.0),
    front_to_back_db: float = 25.0,
    sidelobe_db: float = 20.0,
) -> Floats:
    """Return the gain (...,) in dBi of a sector antenna, broadcast over its arguments (TR 36.814, Table A.2.1.1-2).

    Azimuth from boresight; departure elevation, up positive; down-tilt, down positive; 3 dB widths: all in rad.
    """
    azimuth = wrap_angle(azimuth_offset_rad)
    below = -np.asarray(elevation_rad, np.float64) - np.asarray(tilt_rad, np.float64)
    horizontal = np.minimum(12.0 * (azimuth / azimuth_width_rad) ** 2, front_to_back_db)
    vertical = np.minimum(12.0 * (below / elevation_width_rad) ** 2, sidelobe_db)
    return np.asarray(peak_dbi - np.minimum(horizontal + vertical, front_to_back_db), np.float64)


def element_gain_db(
    azimuth_offset_rad: ArrayLike,
    elevation_rad: ArrayLike,
    peak_dbi: float = 8.0,
    width_rad: float = np.radians(65.0),
    floor_db: float = 30.0,
) -> Floats:
    """Return the gain (...,) in dBi of a patch, broadcast over its arguments (TR 38.901, Table 7.3-1).

    Both angles, in rad, are measured from the patch's normal. The table's min(x, floor) is replaced by
    x / (1 + (x / floor)^4)^(1/4), which differs by less than 0.1 dB above -12 dB and has derivatives
    everywhere.
    """
    azimuth, elevation = wrap_angle(azimuth_offset_rad), np.asarray(elevation_rad, np.float64)
    loss = _smooth_floor(12.0 * (azimuth / width_rad) ** 2, floor_db)
    loss = loss + _smooth_floor(12.0 * (elevation / width_rad) ** 2, floor_db)
    return np.asarray(peak_dbi - _smooth_floor(loss, floor_db), np.float64)


def _smooth_floor(loss_db: Floats, floor_db: float) -> Floats:
    return np.asarray(loss_db / (1.0 + (loss_db / floor_db) ** 4) ** 0.25, np.float64)
