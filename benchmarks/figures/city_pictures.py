"""Pictures of a city: its plan and a view from above, with rays if there are any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch

from cellslam.benchmarks.figures import style
from cellslam.sim.city.city import GROUND, City, Floats
from cellslam.sim.rays.exchange.traced_paths import Traced

# By kind of path.
KIND_COLOURS = (style.GREEN, style.BLUE, style.PURPLE, style.VERMILLION)
KIND_NAMES = ("line of sight", "one reflection", "two reflections", "diffraction")
SHOWN_RAYS = 600
SUN = np.array([0.45, -0.6, 0.9]) / np.linalg.norm([0.45, -0.6, 0.9])
AZIMUTH_RAD, ELEVATION_RAD = -2.0, 0.62  # from where a view is seen
SHADOW = 0.66  # of the light that the ground has in the sun
ROOF = 0.5  # the least vertical part of a roof's normal


def draw_plan(path: Path, city: City, rays: Traced | None = None) -> None:
    """Write the plan of a city, buildings shaded by height, with rays seen from above."""
    low, high = _extent(_shown(city, rays)[:, :2])
    wide, tall = (high - low) / (high - low).max()
    with style.context():
        figure = Figure(figsize=(max(7.0 * wide, 3.5) + 1.6, max(7.0 * tall, 3.5) + 0.8), layout="constrained")
        axes = figure.subplots()
        _buildings(figure, axes, city)
        axes.add_collection(LineCollection([s[:, :2] for s in city.streets], colors=style.GREY, linewidths=0.7))
        if rays is not None:
            _rays(axes, rays, np.eye(3)[:2], width=0.4, alpha=0.5)
            axes.plot(*rays.receivers_m[:, :2].T, ".", color=style.BLACK, markersize=2.0, label="receivers")
            for line in figure.legend(loc="outside lower center", ncols=4).get_lines():
                line.set_linewidth(1.5)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axes.set_title(f"{city.name}: {len(city.footprints)} buildings")
        axes.grid(False)
        style.save(figure, path)


def draw_view(path: Path, city: City, rays: Traced | None = None) -> None:
    """Write a picture of a city from above and aside, in parallel projection; rays are drawn over it."""
    cos, sin = np.cos([AZIMUTH_RAD, ELEVATION_RAD]), np.sin([AZIMUTH_RAD, ELEVATION_RAD])
    right, ahead = np.array([-sin[0], cos[0], 0.0]), -np.array([cos[1] * cos[0], cos[1] * sin[0], sin[1]])
    screen = np.stack([right, np.cross(right, ahead)])
    low, high = _extent(_shown(city, rays) @ screen.T)
    with style.context():
        figure = Figure(figsize=(8.75, 8.75 * (high - low)[1] / (high - low)[0]))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.add_collection(_facets(city, screen, ahead))
        if rays is not None:
            _rays(axes, rays, screen, width=0.7, alpha=0.7)
        names = [city.materials[m].name for m in np.unique(city.facets.material)]
        colours = {name.replace("_", " "): style.material_colour(name) for name in names}
        swatches = [Patch(facecolor=colour, edgecolor=style.GREY, label=name) for name, colour in colours.items()]
        axes.legend(handles=swatches, loc="upper left")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.axis("off")
        style.save(figure, path)


def _facets(city: City, screen: Floats, ahead: Floats) -> PolyCollection:
    """Return a city's triangles on the screen (2, 3), seen along `ahead` (3,), so that what is nearer hides the rest.

    The ground comes first, then the shadows on it, then far buildings before near ones, and of each its walls before
    its roof: right for buildings that stand apart.
    """
    corners, building = city.vertices[city.triangles], city.facets.building[city.triangle_facet]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    depth = (corners @ ahead).mean(axis=1)
    _, own, count = np.unique(building, return_inverse=True, return_counts=True)
    distance = np.where(building == GROUND, np.inf, (np.bincount(own, depth) / count)[own])
    order = np.lexsort((-depth, np.abs(normal[:, 2]) > ROOF, -distance))
    palette = np.array([style.material_colour(material.name) for material in city.materials])
    # A wall is seen from outside, whichever way its triangles turn.
    normal *= -np.sign(normal @ ahead)[:, None]
    light = 0.64 + 0.36 * np.clip(normal @ SUN, 0.0, 1.0)
    colour = palette[city.facets.material[city.triangle_facet]] * light[:, None]
    ground, standing = order[building[order] == GROUND], order[building[order] != GROUND]
    # A shadow lies where the rays of the sun through a triangle meet the plane of zero height, if there is ground.
    cast = corners[standing] if len(ground) else corners[:0]
    shadows = cast - cast[:, :, 2:] * (SUN / SUN[2])
    dark = np.repeat(SHADOW * palette[city.facets.material[city.triangle_facet[ground[:1]]]], len(cast), axis=0)
    drawn = np.concatenate([corners[ground], shadows, corners[standing]]) @ screen.T
    colours = np.concatenate([colour[ground], dark.reshape(-1, 3), colour[standing]])
    return PolyCollection(list(drawn), facecolors=colours, edgecolors="face", linewidths=0.3)


def _buildings(figure: Figure, axes: Axes, city: City) -> None:
    order = np.argsort(city.heights_m, kind="stable")
    patches = PatchCollection(
        [PathPatch(style.outline(city.footprints[i])) for i in order], cmap="YlOrBr", edgecolor="#8C8577", linewidth=0.3
    )
    patches.set_array(city.heights_m[order])
    patches.set_clim(0.0, 1.25 * float(city.heights_m.max(initial=1.0)))
    axes.add_collection(patches)
    figure.colorbar(patches, ax=axes, shrink=0.6, label="height (m)")


def _rays(axes: Axes, rays: Traced, screen: Floats, width: float, alpha: float) -> None:
    """Draw rays and transmitters on a screen (2, 3): the directions to the right and up.

    Of very many rays, those of evenly spaced receivers.
    """
    kept = np.unique(rays.paths.receiver)[:: max(1, -(-len(rays.paths) // SHOWN_RAYS))]
    paths = rays.paths.take(np.isin(rays.paths.receiver, kept))
    ends = rays.transmitters_m[paths.transmitter], rays.receivers_m[paths.receiver]
    corners = np.concatenate([ends[0][:, None], paths.points_m, ends[1][:, None]], axis=1)
    lines = [line[~np.isnan(line[:, 0])] for line in corners]  # transmitter, specular points, receiver
    for kind in np.unique(paths.kind)[::-1].tolist():
        chosen = [line @ screen.T for line, own in zip(lines, paths.kind, strict=True) if own == kind]
        drawn: dict[str, Any] = {"colors": KIND_COLOURS[kind], "label": KIND_NAMES[kind]}
        axes.add_collection(LineCollection(chosen, linewidths=width, alpha=alpha, **drawn))
    x, y = screen @ rays.transmitters_m.T
    axes.plot(x, y, "^", color=style.VERMILLION, markeredgecolor=style.BLACK, label="transmitters")


def _shown(city: City, rays: Traced | None) -> Floats:
    """Return the points (N, 3) that a picture must show: rays and their ends, or else all buildings."""
    if rays is not None:
        corners = rays.paths.points_m.reshape(-1, 3)
        return np.concatenate([rays.transmitters_m, rays.receivers_m, corners[~np.isnan(corners[:, 0])]])
    chosen = city.facets.building[city.triangle_facet] != GROUND
    return np.asarray(city.vertices[np.unique(city.triangles[chosen] if chosen.any() else city.triangles)], np.float64)


def _extent(points: Floats) -> tuple[Floats, Floats]:
    """Return the lower and upper corner of what holds the points (N, 2), with a margin, neither side very short."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    half = np.maximum(1.05 * half, 0.45 * half.max()) + 5.0
    return (low + high) / 2 - half, (low + high) / 2 + half
