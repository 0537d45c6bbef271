"""Trajectories and VTs of an estimate, or of the truth, in formats of other tools: TUM, GeoJSON, PLY."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import VtEstimate, WallEstimate

ELLIPSE_POINTS = 32
SIGMAS = 2.0
SEMI_MAJOR_M, ECCENTRICITY_2 = 6378137.0, 0.00669437999014  # WGS 84
Place = Callable[[Floats], Any]


@dataclass(frozen=True)
class Shown:
    """What is exported: a trajectory (T,), (T, 6), VTs and walls, if there are any."""

    name: str
    time_s: Floats
    poses: Floats
    vts: VtEstimate
    walls: WallEstimate | None = None


def shown(recording: Recording, result: TrialResult | None) -> Shown:
    """Return the estimate, or without one the truth or the reference. Raises InputError if there is none of these."""
    none, truth, reference = np.empty(0, np.int64), recording.truth, recording.reference
    no_vts = VtEstimate(none, none, np.empty((0, 3)), np.empty((0, 3, 3)))
    if result is not None:
        vts = no_vts if result.vts is None else result.vts
        return Shown(result.estimator, recording.time_s, result.poses, vts, result.walls)
    if truth is not None:
        of_vts = truth.measurement_vt >= 0
        pairs = np.unique(np.column_stack([recording.measurements.link, truth.measurement_vt])[of_vts], axis=0)
        link, vt = pairs.T if len(pairs) else (none, none)
        kind = None if truth.vts.scatterer is None else truth.vts.scatterer[vt]
        vts = VtEstimate(vt, link, truth.vts.position_m[vt], np.zeros((len(vt), 3, 3)), kind)
        return Shown("truth", recording.time_s, truth.poses, vts)
    if reference is None:
        raise InputError("the recording has neither truth nor reference: say which --estimator to export")
    angles = np.column_stack([np.nan_to_num(reference.yaw_rad), np.zeros((len(reference), 2))])
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1)
    poses = np.column_stack([np.nan_to_num(reference.position_m), angles])[known]
    return Shown("reference", reference.time_s[known], poses, no_vts)


def geojson(data: Shown, place: Place, path: Path) -> None:
    """Write VTs as points with covariance and 2-sigma ellipses, walls as lines, and the trajectory, `place`d on the
    Earth."""
    features = [_feature("LineString", place(data.poses[:, :3]), {"kind": "trajectory", "name": data.name})]
    vts = data.vts
    for i in range(len(vts.id)):
        covariance = vts.covariance[i]
        about = {
            "kind": "vt" if vts.scatterer is None or vts.scatterer[i] == 0 else "scatterer",
            "id": int(vts.id[i]),
            "link": int(vts.link[i]),
            "position_m": vts.position_m[i].tolist(),
            "covariance_m2": covariance.tolist(),
            "std_m": np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(),
        }
        features.append(_feature("Point", place(vts.position_m[i : i + 1])[0], about))
        if covariance.any():
            ring = place(_ellipse(vts.position_m[i], covariance))
            features.append(_feature("Polygon", [ring], {"kind": "ellipse", "vt": int(vts.id[i]), "sigmas": SIGMAS}))
    if data.walls is not None:
        features += _walls(data.walls, float(data.poses[0, 2]), place)
    text = json.dumps({"type": "FeatureCollection", "features": features})
    path.write_text(text, "utf-8")


def _walls(walls: WallEstimate, height_m: float, place: Place) -> list[dict[str, Any]]:
    """Return the visible parts of walls as lines, drawn at this height."""
    features = []
    for i, ends in enumerate(walls.ends_m):
        about = {
            "kind": "wall",
            "id": int(walls.id[i]),
            "azimuth_rad": float(walls.azimuth_rad[i]),
            "distance_m": float(walls.distance_m[i]),
            "covariance": walls.covariance[i].tolist(),
            "ends_m": ends.tolist(),
        }
        features.append(_feature("LineString", place(np.column_stack([ends, np.full(2, height_m)])), about))
    return features


def _feature(kind: str, coordinates: Any, about: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": about}


def _ellipse(centre: Floats, covariance: Floats) -> Floats:
    """Return the closed outline (n, 3) of the horizontal 2-sigma ellipse."""
    value, axes = np.linalg.eigh(covariance[:2, :2])
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    ring = centre[:2, None] + SIGMAS * axes @ (np.sqrt(np.maximum(value, 0.0))[:, None] * circle)
    out = np.column_stack([*ring, np.full(len(angle), centre[2])])
    out[-1] = out[0]
    return out


def placement(recording: Recording, origin_deg: tuple[float, float] | None) -> Place:
    """Return what makes longitude and latitude (WGS 84) in degrees of points (n, 3) in the recording's world frame.

    Its zero lies at `origin_deg` (latitude, longitude), or where the reference was projected from. Raises InputError
    where neither is known: GeoJSON has no metres (RFC 7946, section 4).
    """
    if origin_deg is not None:
        return _at_origin(*origin_deg)
    projection = recording.provenance.get("projection")
    if not isinstance(projection, dict):
        raise InputError(
            "GeoJSON holds longitudes and latitudes, and this recording does not say where on the Earth it lies: give "
            "--origin LATITUDE,LONGITUDE of its world frame's zero (x east, y north), or write ply and tum, in metres"
        )
    try:
        import pyproj
    except ImportError:
        raise InputError("this recording is placed on the Earth: pip install 'cellslam[gnss]' to export it") from None
    back = pyproj.Transformer.from_crs(projection["crs"], "EPSG:4326", always_xy=True)
    east, north = projection["origin_m"]
    return lambda points: _rounded(*back.transform(points[:, 0] + east, points[:, 1] + north), points[:, 2])


def _at_origin(latitude_deg: float, longitude_deg: float) -> Place:
    """Return the placement of points in the plane that touches WGS 84 at the origin, exact to 1 m over 3 km.

    By the radii of curvature there: E. Krakiwsky and D. Thomson, Geodetic position computations, 1974, section 1.
    """
    sine = np.sin(np.radians(latitude_deg))
    across = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    along = across * (1.0 - ECCENTRICITY_2) / (1.0 - ECCENTRICITY_2 * sine**2)

    def place(points: Floats) -> Any:
        longitude = longitude_deg + np.degrees(points[:, 0] / (across * np.sqrt(1.0 - sine**2)))
        return _rounded(longitude, latitude_deg + np.degrees(points[:, 1] / along), points[:, 2])

    return place


def _rounded(*columns: Floats) -> Any:
    return np.column_stack(columns).round(9).tolist()


def ply(data: Shown, path: Path) -> None:
    """Write VTs as vertices with id, link and the six covariance terms in square metres."""
    terms = ("xx", "xy", "xz", "yy", "yz", "zz")
    vts = data.vts
    head = [
        "ply",
        "format ascii 1.0",
        f"comment VTs of {data.name}, metres",
        f"element vertex {len(vts.id)}",
        *(f"property double {axis}" for axis in "xyz"),
        "property int id",
        "property int link",
        *(f"property double covariance_{term}" for term in terms),
        "end_header",
    ]
    rows, columns = np.triu_indices(3)
    table = np.column_stack([vts.position_m, vts.id, vts.link, vts.covariance[:, rows, columns]])
    formats = [*["%.6f"] * 3, "%d", "%d", *["%.9g"] * 6]
    np.savetxt(path, table, formats, header="\n".join(head), comments="")
