"""The map of walls against the walls that reflected paths to the vehicle.

Walls are compared by their visible parts, seen from above: segments between the outermost points at which detected
paths were reflected. Sources: Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment
metric", FUSION 2017, over the distance of Hausdorff (Grundzüge der Mengenlehre, 1914), which is a metric too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components
from shapely import hausdorff_distance, linestrings

from cellslam.benchmarks.scores.map_scores import gospa
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording, Truth
from cellslam.slam.api import WallEstimate
from cellslam.slam.model.walls import normals, reflection_point

DETECTIONS_OF_A_TRUE_WALL = 20
STEEPEST = 0.1  # sine of the tilt from which a facet is no wall
# Facets that lie in one plane, so far as anybody can tell, are one wall: less than so far apart in rad, m, and along.
ONE_PLANE_RAD, ONE_PLANE_M, ONE_PLANE_GAP_M = float(np.radians(1.0)), 0.5, 10.0
# A piece of a facade is mapped where a wall of this direction has been estimated so near.
MAPPED_RAD, MAPPED_M, PIECE_M = float(np.radians(10.0)), 5.0, 0.5


@dataclass(frozen=True)
class Walls:
    """Visible parts of walls: azimuth (W,) of the normals in rad, ends (W, 2, 2) in m."""

    azimuth_rad: Floats
    ends_m: Floats

    def __len__(self) -> int:
        return len(self.azimuth_rad)

    @property
    def length_m(self) -> Floats:
        """Length (W,) of the visible parts."""
        return np.asarray(np.linalg.norm(self.ends_m[:, 1] - self.ends_m[:, 0], axis=-1))

    def across(self, points_m: Floats) -> Floats:
        """Return the distances (W, n) of points (n, 2) from the walls' planes, in m, along the normals."""
        normal = normals(self.azimuth_rad)[0]
        return np.asarray(normal @ points_m.T - (normal * self.ends_m[:, 0]).sum(axis=1)[:, None])


def wall_scores(recording: Recording, truth: Truth, estimated: WallEstimate) -> dict[str, float | None]:
    """Return the scores of a map of walls by key, as docs/reference/conventions.md defines them."""
    true, found = true_walls(recording, truth), Walls(estimated.azimuth_rad, estimated.ends_m)
    distance_m, pairs = gospa(hausdorff(true, found))
    a, b = pairs.T
    middles = true.ends_m[a].mean(axis=1)
    off = np.diagonal(Walls(found.azimuth_rad[b], found.ends_m[b]).across(middles))
    return {
        "wall_gospa_m": distance_m,
        "wall_share": mapped_share(true, found),
        "wall_normal_rmse_rad": _rms(wrap_angle(true.azimuth_rad[a] - found.azimuth_rad[b])),
        "wall_offset_rmse_m": _rms(off),
    }


def true_walls(recording: Recording, truth: Truth) -> Walls:
    """Return the walls over which a single reflection was measured at least 20 times, facets in one plane as one."""
    azimuth, points = _facets(recording, truth)
    facets = _spanned(azimuth, points)
    weighted = (facets.length_m + PIECE_M)[:, None] * normals(azimuth)[0]
    joined, direction = list[Floats](), list[float]()
    count, front = connected_components(_one_plane(facets)) if len(facets) else (0, np.zeros(0))
    for k in range(count):
        mine = np.flatnonzero(front == k)
        x, y = weighted[mine].sum(axis=0)
        direction.append(float(np.arctan2(y, x)))
        joined.append(np.concatenate([points[i] for i in mine]))
    return _spanned(np.array(direction), joined)


def _facets(recording: Recording, truth: Truth) -> tuple[Floats, list[Floats]]:
    """Return azimuths (F,) of the normals of facets in rad, and where they reflected detected paths, (n, 2) in m."""
    m, vts = recording.measurements, truth.vts
    away = vts.position_m - truth.site_positions_m[vts.site]
    vertical = (vts.order == 1) & ~vts.scatters & (np.abs(away[:, 2]) <= STEEPEST * np.linalg.norm(away, axis=1))
    rows = np.flatnonzero(truth.measurement_vt >= 0)
    rows = rows[vertical[truth.measurement_vt[rows]]]
    vt, when = np.unique(np.stack([truth.measurement_vt[rows], m.snapshot[rows]]), axis=1)
    points = reflection_point(truth.site_positions_m[vts.site[vt]], vts.position_m[vt], truth.poses[when, :3])[:, :2]
    there = np.isfinite(points).all(axis=1)  # a truth that others made may have VTs that are no mirror images
    vt, points = vt[there], points[there]
    facet, often = np.unique(vts.facets[truth.measurement_vt[rows], 0], return_counts=True)
    mine = [np.flatnonzero(vts.facets[vt, 0] == f) for f in facet[often >= DETECTIONS_OF_A_TRUE_WALL]]
    mine = [rows for rows in mine if len(rows)]
    direction = np.array([away[vt[rows[0]], :2] for rows in mine]).reshape(-1, 2)
    return np.arctan2(direction[:, 1], direction[:, 0]), [points[rows] for rows in mine]


def hausdorff(a: Walls, b: Walls) -> Floats:
    """Return the Hausdorff distances (A, B) in m of segments: how far the farthest end of one is from the other."""
    return np.asarray(hausdorff_distance(linestrings(a.ends_m)[:, None], linestrings(b.ends_m)))


def mapped_share(true: Walls, found: Walls) -> float | None:
    """Return the share of the true walls' length that is mapped; None where nothing was seen.

    Mapped is what lies abreast of the visible part of an estimated wall, within 5 m of it and 10 degrees.
    """
    pieces = np.maximum(np.ceil(true.length_m / PIECE_M), 1.0).astype(np.int64)
    if not true.length_m.sum():
        return None
    wall = np.repeat(np.arange(len(true)), pieces)
    place = (np.arange(len(wall)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[wall]
    ends, along = true.ends_m[wall], normals(found.azimuth_rad)[1]
    points = ends[:, 0] + place[:, None] * (ends[:, 1] - ends[:, 0])
    extent, t = (found.ends_m * along[:, None]).sum(axis=-1), along @ points.T
    near = np.abs(found.across(points)) <= MAPPED_M
    near &= (t >= extent.min(axis=1)[:, None]) & (t <= extent.max(axis=1)[:, None])
    near &= np.abs(wrap_angle(found.azimuth_rad[:, None] - true.azimuth_rad[wall])) <= MAPPED_RAD
    weight = (true.length_m / pieces)[wall]
    return float(weight[near.any(axis=0)].sum() / weight.sum())


def _spanned(azimuth: Floats, points: list[Floats]) -> Walls:
    """Return walls of these azimuths (W,) through the means of their points (n, 2), from the first to the last."""
    ends = np.empty((len(points), 2, 2))
    for k, (along, mine) in enumerate(zip(normals(azimuth)[1], points, strict=True)):
        middle, t = mine.mean(axis=0), mine @ along
        ends[k] = middle + (np.array([[t.min()], [t.max()]]) - middle @ along) * along
    return Walls(azimuth, ends)


def _one_plane(walls: Walls) -> Ints:
    """Return which walls (W, W) lie in one plane and next to each other."""
    off = np.abs(walls.across(walls.ends_m.reshape(-1, 2))).reshape(len(walls), len(walls), 2).max(axis=2)
    turned = np.abs(wrap_angle(walls.azimuth_rad[:, None] - walls.azimuth_rad))
    t = np.einsum("jec,ic->ije", walls.ends_m, normals(walls.azimuth_rad)[1])
    low, high = t.min(axis=2), t.max(axis=2)
    gap = np.maximum(low - np.diag(high)[:, None], np.diag(low)[:, None] - high)
    return np.asarray((off < ONE_PLANE_M) & (turned < ONE_PLANE_RAD) & (gap < ONE_PLANE_GAP_M), np.int64)


def _rms(values: Floats) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None
