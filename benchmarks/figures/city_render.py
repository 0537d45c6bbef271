"""A picture of a city in three dimensions: one ray per pixel, one to the sun, edges where facets meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import Floats
from cellslam.sim.rays import Scene

# Colours of materials, as red, green, blue; grounds last.
COLOURS = {
    "concrete": (0.80, 0.78, 0.74),
    "brick": (0.78, 0.56, 0.46),
    "glass": (0.58, 0.75, 0.84),
    "metal": (0.66, 0.69, 0.73),
    "wood": (0.76, 0.63, 0.44),
    "marble": (0.90, 0.88, 0.84),
    "ground": (0.90, 0.91, 0.87),
}
OTHER = (0.77, 0.73, 0.80)
SKY = (1.0, 1.0, 1.0)
SUN = np.array([0.45, -0.6, 0.9]) / np.linalg.norm([0.45, -0.6, 0.9])
NO_HIT = 1e30


@dataclass(frozen=True)
class Camera:
    """An orthographic camera: `right`, `up`, `ahead` are unit vectors (3,); the picture spans `half` (2,) metres to
    either side of `centre` (3,), which is in centred coordinates.
    """

    right: Floats
    up: Floats
    ahead: Floats
    centre: Floats
    half: Floats

    def project(self, points: Floats) -> Floats:
        """Return picture coordinates (N, 2), from 0 at the lower left to 1, of points (N, 3) in m, centred."""
        away = points - self.centre
        return np.column_stack([away @ self.right / self.half[0], away @ self.up / self.half[1]]) * 0.5 + 0.5


def material_colour(name: str) -> tuple[float, float, float]:
    """Return the colour (red, green, blue) of a material by name."""
    return COLOURS.get("ground" if "ground" in name else name, OTHER)


def camera_for(points: Floats, azimuth_rad: float = -2.0, elevation_rad: float = 0.62) -> Camera:
    """Return a camera that shows the points (N, 3) in m, centred, from a direction (azimuth, elevation) in rad."""
    cos, sin = np.cos(elevation_rad), np.sin(elevation_rad)
    ahead = -np.array([cos * np.cos(azimuth_rad), cos * np.sin(azimuth_rad), sin])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    plan = np.column_stack([points @ right, points @ up])
    low, high = plan.min(axis=0), plan.max(axis=0)
    middle = (low + high) / 2
    half = (high - low) / 2
    half = np.maximum(1.05 * half, 0.5 * half.max()) + 5.0
    return Camera(right, up, ahead, middle[0] * right + middle[1] * up, half)


def render(scene: Scene, camera: Camera, width: int = 1400, samples: int = 2) -> NDArray[np.float64]:
    """Return the picture (rows, width, 3), 0 to 1; `samples` squared rays per pixel."""
    columns = width * samples
    rows = max(1, round(columns * camera.half[1] / camera.half[0] / samples)) * samples
    x = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * camera.half[0]
    y = (1.0 - (np.arange(rows) + 0.5) / rows * 2.0) * camera.half[1]
    back = float(np.linalg.norm(np.ptp(scene.city.vertices, axis=0))) + 10.0
    shades, labels = [], []
    for some in np.array_split(y, max(1, rows * columns // 1_000_000)):
        plan = camera.centre + some[:, None, None] * camera.up + x[None, :, None] * camera.right
        shade, label = _shade(scene, (plan - back * camera.ahead).reshape(-1, 3), camera.ahead)
        shades.append(shade.reshape(len(some), columns, 3))
        labels.append(label.reshape(len(some), columns))
    picture, label = np.concatenate(shades), np.concatenate(labels)
    edge = np.zeros(label.shape, np.bool_)
    edge[:, 1:] |= label[:, 1:] != label[:, :-1]
    edge[1:] |= label[1:] != label[:-1]
    picture[edge] *= 0.62
    return np.asarray(picture.reshape(rows // samples, samples, width, samples, 3).mean(axis=(1, 3)), np.float64)


def _shade(scene: Scene, origins: Floats, ahead: Floats) -> tuple[Floats, Any]:
    """Return colours (N, 3) and facets (N,), -1 none, of parallel rays."""
    tree = scene.embree[0]
    start = np.ascontiguousarray(origins, np.float32)
    hit = tree.run(start, np.ascontiguousarray(np.broadcast_to(ahead, start.shape), np.float32), output=True)
    triangle = hit["primID"]
    found = triangle >= 0
    facet = np.where(found, scene.city.triangle_facet[triangle], -1)
    normal = scene.table[facet, :3]
    normal = np.where((normal @ ahead)[:, None] > 0.0, -normal, normal)
    towards = normal @ SUN
    points = origins + hit["tfar"][:, None].astype(np.float64) * ahead + 0.02 * normal
    lit = np.zeros(len(start), np.bool_)
    facing = np.flatnonzero(found & (towards > 0.0))
    if len(facing):
        sun = np.ascontiguousarray(np.broadcast_to(SUN, (len(facing), 3)), np.float32)
        reach = np.full(len(facing), NO_HIT, np.float32)
        lit[facing] = (
            tree.run(np.ascontiguousarray(points[facing], np.float32), sun, dists=reach, query="OCCLUDED") == -1
        )
    palette = np.array([material_colour(m.name) for m in scene.city.materials])
    colour = palette[scene.city.facets.material[facet]]
    light = 0.52 + 0.12 * normal[:, 2:] + 0.42 * np.where(lit, towards, 0.0)[:, None]
    return np.where(found[:, None], np.clip(colour * light, 0.0, 1.0), SKY), facet
