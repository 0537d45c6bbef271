"""Vertical walls, as VTs show them: the plane that mirrors a site to its VT, and where paths meet it.

A wall's normal points away from the sites that are received over it. Its azimuth a and its distance d from a point q
are those of n = (cos a, sin a), n (x - q) = d for all x on the wall; along it counts what is along (-sin a, cos a).
Source: Leitinger, Venus, Teague and Meyer, "Data fusion for multipath-based SLAM: combining information from multiple
propagation paths", IEEE Trans. Signal Processing 71, 2023, section III: a wall and the sites' mirror images in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.recording import Floats


def normals(azimuth_rad: ArrayLike) -> tuple[Floats, Floats]:
    """Return the unit vectors (..., 2) across walls of these azimuths (...,) in rad, and those along them."""
    azimuth = np.asarray(azimuth_rad, np.float64)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return across, quarter_turned(across)


def quarter_turned(vectors: Floats) -> Floats:
    """Return horizontal vectors (..., 2) turned by 90 degrees counter-clockwise."""
    return np.asarray(np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1))


def mirror_plane(site_m: Floats, vt_m: Floats, about_m: Floats) -> tuple[Floats, Floats]:
    """Return the plane (..., 2) that mirrors a site to a VT, (..., 2 or 3) in m, and its Jacobian (..., 2, 4).

    The plane: azimuth in rad, and distance in m from `about_m` (..., 2). The Jacobian is by x and y of the site, then
    of the VT; neither heights nor the tilt of a wall that is not vertical count.
    """
    site, vt = site_m[..., :2], vt_m[..., :2]
    away, off = vt - site, 0.5 * (site + vt) - about_m
    length = np.hypot(away[..., 0], away[..., 1])[..., None]
    across = away / length
    along = quarter_turned(across)
    plane = np.stack([np.arctan2(away[..., 1], away[..., 0]), (off * across).sum(axis=-1)], axis=-1)
    turns = along / length  # of the azimuth by the VT; by the site it turns back
    lever = (off * along).sum(axis=-1)[..., None] * turns
    by_azimuth = np.concatenate([-turns, turns], axis=-1)
    by_distance = np.concatenate([0.5 * across - lever, 0.5 * across + lever], axis=-1)
    return plane, np.stack([by_azimuth, by_distance], axis=-2)


def image_in_wall(site_m: Floats, vt_m: Floats, point_m: Floats) -> tuple[Floats, Floats]:
    """Return the image (2,) of a point in the wall that mirrors a site to a VT, (2,) in m, and its Jacobian (2, 6).

    The Jacobian is by x and y of the site, of the VT, and of the point.
    """
    about = 0.5 * (site_m + vt_m)
    (azimuth, distance), by_ends = mirror_plane(site_m, vt_m, about)
    across, along = normals(azimuth)
    off = point_m - about
    behind = off @ across - distance
    by_azimuth = -2.0 * (behind * along + (off @ along) * across)
    by_plane = np.column_stack([by_azimuth, 2.0 * across])
    by_point = np.eye(2) - 2.0 * np.outer(across, across)
    return np.asarray(point_m - 2.0 * behind * across), np.concatenate([by_plane @ by_ends, by_point], axis=1)


def reflection_point(site_m: Floats, vt_m: Floats, vehicle_m: Floats) -> Floats:
    """Return where the path from the site to `vehicle_m` (..., 3) meets the wall that makes `vt_m`, (..., 3) in m.

    The wall is the perpendicular bisector plane of site and VT; the point is where the segment from the vehicle to the
    VT meets it, NaN where it does not (the vehicle is behind the wall).
    """
    normal = vt_m - site_m
    towards = vt_m - vehicle_m
    along = (towards * normal).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((0.5 * (site_m + vt_m) - vehicle_m) * normal).sum(axis=-1) / along
        point = vehicle_m + share[..., None] * towards
    return np.asarray(np.where(((share > 0) & (share < 1))[..., None], point, np.nan))
