"""Trajectories and VTs of an estimate, or of the truth, in formats of other tools: TUM, GeoJSON, PLY."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import write_tum
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.api import WallEstimate

ELLIPSE_POINTS = 32
SIGMAS = 2.0
SEMI_MAJOR_M, ECCENTRICITY_2 = 6378137.0, 0.00669437999014  # WGS 84
Place = Callable[[Floats], Any]


@dataclass(frozen=True)
class Shown:
    """What is exported: a trajectory (T,), (T, 6), and points (V,) with link, position (V, 3), covariance (V, 3, 3);
    walls, if there are any."""

    name: str
    time_s: Floats
    poses: Floats
    id: Ints
    link: Ints
    position_m: Floats
    covariance: Floats
    walls: WallEstimate | None = None


def shown(recording: Recording, result: TrialResult | None) -> Shown:
    """Return the estimate, or without one the truth or the reference. Raises InputError if there is none of these."""
    if result is not None:
        v = result.vts
        if v is None:
            return _without_points(result.estimator, recording.time_s, result.poses)
        points = (v.id, v.link, v.position_m, v.covariance)
        return Shown(result.estimator, recording.time_s, result.poses, *points, result.walls)
    t = recording.truth
    if t is not None:
        pairs = np.unique(
            np.column_stack([recording.measurements.link, t.measurement_vt])[t.measurement_vt >= 0], axis=0
        )
        link, vt = pairs.T if len(pairs) else (np.empty(0, np.int64), np.empty(0, np.int64))
        return Shown("truth", recording.time_s, t.poses, vt, link, t.vts.position_m[vt], np.zeros((len(vt), 3, 3)))
    r = recording.reference
    if r is None:
        raise InputError("the recording has neither truth nor reference: say which --estimator to export")
    rest = np.zeros((len(r), 2))
    poses = np.column_stack([np.nan_to_num(r.position_m), np.nan_to_num(r.yaw_rad), rest])
    known = np.isfinite(r.position_m[:, :2]).all(axis=1)
    return _without_points("reference", r.time_s[known], poses[known])


def _without_points(name: str, time_s: Floats, poses: Floats) -> Shown:
    none = np.empty(0, np.int64)
    return Shown(name, time_s, poses, none, none, np.empty((0, 3)), np.empty((0, 3, 3)))


def tum(data: Shown, path: Path) -> None:
    """Write the trajectory."""
    write_tum(path, data.time_s, data.poses)


def geojson(data: Shown, place: Place, path: Path) -> None:
    """Write VTs as points with covariance and 2-sigma ellipses, walls as lines, and the trajectory, `place`d on the
    Earth."""
    features = [_feature("LineString", place(data.poses[:, :3]), {"kind": "trajectory", "name": data.name})]
    for i in range(len(data.id)):
        covariance = data.covariance[i]
        about = {
            "kind": "vt",
            "id": int(data.id[i]),
            "link": int(data.link[i]),
            "position_m": data.position_m[i].tolist(),
            "covariance_m2": covariance.tolist(),
            "std_m": np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(),
        }
        features.append(_feature("Point", place(data.position_m[i : i + 1])[0], about))
        if covariance.any():
            ring = place(_ellipse(data.position_m[i], covariance))
            features.append(_feature("Polygon", [ring], {"kind": "ellipse", "vt": int(data.id[i]), "sigmas": SIGMAS}))
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
    return _at_origin(*origin_deg) if origin_deg is not None else _as_projected(recording)


def _as_projected(recording: Recording) -> Place:
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

    def place(points: Floats) -> Any:
        longitude, latitude = back.transform(points[:, 0] + east, points[:, 1] + north)
        return np.column_stack([longitude, latitude, points[:, 2]]).round(9).tolist()

    return place


def _at_origin(latitude_deg: float, longitude_deg: float) -> Place:
    """Return the placement of points in the plane that touches WGS 84 at the origin, exact to 1 m over 3 km.

    By the radii of curvature there: E. Krakiwsky and D. Thomson, Geodetic position computations, 1974, section 1.
    """
    sine = np.sin(np.radians(latitude_deg))
    across = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    along = across * (1.0 - ECCENTRICITY_2) / (1.0 - ECCENTRICITY_2 * sine**2)

    def place(points: Floats) -> Any:
        longitude = longitude_deg + np.degrees(points[:, 0] / (across * np.sqrt(1.0 - sine**2)))
        latitude = latitude_deg + np.degrees(points[:, 1] / along)
        return np.column_stack([longitude, latitude, points[:, 2]]).round(9).tolist()

    return place


def ply(data: Shown, path: Path) -> None:
    """Write VTs as vertices with id, link and the six covariance terms in square metres."""
    terms = ("xx", "xy", "xz", "yy", "yz", "zz")
    upper = np.triu_indices(3)
    lines = [
        "ply",
        "format ascii 1.0",
        f"comment VTs of {data.name}, metres",
        f"element vertex {len(data.id)}",
        *(f"property double {axis}" for axis in "xyz"),
        "property int id",
        "property int link",
        *(f"property double covariance_{term}" for term in terms),
        "end_header",
    ]
    for i in range(len(data.id)):
        place = " ".join(f"{x:.6f}" for x in data.position_m[i])
        spread = " ".join(f"{x:.9g}" for x in data.covariance[i][upper])
        lines.append(f"{place} {int(data.id[i])} {int(data.link[i])} {spread}")
    path.write_text("\n".join(lines) + "\n", "ascii")
