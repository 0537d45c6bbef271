"""Latitude and longitude as metres in a plane (pyproj, extra `gnss`)."""

from __future__ import annotations

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats


def projected(latitude_rad: Floats, longitude_rad: Floats, crs: str) -> tuple[Floats, str, Floats]:
    """Return east and north (R, 2) in metres, the CRS used, and the convergence (R,) of its meridians in rad.

    `crs` empty: the UTM zone of the first fix. Convergence: what to add to a yaw from geographic east. NaN in, NaN
    out. Raises
    InputError without pyproj, for an unknown CRS, or for values that are no latitudes.
    """
    try:
        import pyproj
    except ImportError:
        raise InputError("latitude and longitude need pyproj: pip install 'cellslam[gnss]'") from None
    known = np.flatnonzero(np.isfinite(latitude_rad) & np.isfinite(longitude_rad))
    if not len(known):
        raise InputError("reference: no row has latitude and longitude")
    bad = np.flatnonzero((np.abs(latitude_rad) > np.pi / 2) | (np.abs(longitude_rad) > 2 * np.pi))
    if len(bad):
        raise InputError(f"reference, row {bad[0]}: latitude or longitude is out of range; check unit (deg?) and order")
    latitude, longitude = np.degrees(latitude_rad), np.degrees(longitude_rad)
    if not crs:
        zone = int((longitude[known[0]] + 180.0) // 6.0) % 60 + 1
        crs = f"EPSG:{(32600 if latitude[known[0]] >= 0 else 32700) + zone}"
    try:
        projection = pyproj.Proj(crs)
        transform = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise InputError(f"reference.crs = '{crs}': unknown; give one as EPSG:32633") from error
    east, north = np.full(len(latitude), np.nan), np.full(len(latitude), np.nan)
    east[known], north[known] = transform.transform(longitude[known], latitude[known])
    convergence = np.full(len(latitude), np.nan)
    convergence[known] = np.radians(projection.get_factors(longitude[known], latitude[known]).meridian_convergence)
    return np.column_stack([east, north]), crs, convergence
