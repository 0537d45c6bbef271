"""Pictures of a city: its plan and a view from above, with rays if there are any."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline

from cellslam.benchmarks.figures.city_render import camera_for, material_colour, render
from cellslam.benchmarks.figures.style import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION, context
from cellslam.sim.city.city import GROUND, City, Floats
from cellslam.sim.rays import Paths, Scene, prepare

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# By kind of path.
KIND_COLOURS = (GREEN, BLUE, PURPLE, VERMILLION)
KIND_NAMES = ("line of sight", "one reflection", "two reflections", "diffraction")
SHOWN_RAYS = 600


def ray_lines(paths: Paths, transmitters: Floats, receivers: Floats) -> list[Floats]:
    """Return per path its corners (order + 2, 3) in m: transmitter, specular points, receiver.

    Transmitters (S, 3), receivers (N, 3).
    """
    ends = transmitters[paths.transmitter], receivers[paths.receiver]
    corners = np.concatenate([ends[0][:, None], paths.points_m, ends[1][:, None]], axis=1)
    return [c[~np.isnan(c[:, 0])] for c in corners]


def some_rays(paths: Paths, most: int = SHOWN_RAYS) -> Paths:
    """Return at most `most` paths, those of evenly spaced receivers."""
    if len(paths) <= most:
        return paths
    receivers = np.unique(paths.receiver)
    kept = receivers[:: int(np.ceil(len(paths) / most))]
    return paths.take(np.isin(paths.receiver, kept))


def draw_plan(
    path: Path,
    city: City,
    paths: Paths | None = None,
    transmitters: Floats | None = None,
    receivers: Floats | None = None,
) -> None:
    """Write the plan of a city, buildings shaded by height, with rays seen from above.

    Transmitters (S, 3) and receivers (N, 3) in m.
    """
    with context():
        low, high = _extent(_shown(city, paths, transmitters, receivers)[:, :2])
        wide, tall = (high - low) / (high - low).max()
        figure = Figure(figsize=(max(7.0 * wide, 3.5) + 1.6, max(7.0 * tall, 3.5) + 0.8), layout="constrained")
        axes = figure.subplots()
        _buildings(figure, axes, city)
        axes.add_collection(LineCollection([s[:, :2] for s in city.streets], colors=GREY, linewidths=0.7))
        if paths is not None and transmitters is not None and receivers is not None:
            _rays(axes, some_rays(paths), transmitters, receivers)
            axes.plot(*receivers[:, :2].T, ".", color=BLACK, markersize=2.0, label="receivers")
            axes.plot(*transmitters[:, :2].T, "^", color=VERMILLION, markeredgecolor=BLACK, label="transmitters")
            for line in figure.legend(loc="outside lower center", ncols=4).get_lines():
                line.set_linewidth(1.5)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.grid(False)
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        axes.set_title(f"{city.name}: {len(city.footprints)} buildings")
        figure.savefig(path)


def draw_view(
    path: Path,
    city: City | Scene,
    paths: Paths | None = None,
    transmitters: Floats | None = None,
    receivers: Floats | None = None,
    width: int = 1400,
) -> None:
    """Write a picture of a city from above and aside, `width` pixels wide, with shadows; rays are drawn over it.

    Transmitters (S, 3) and receivers (N, 3) in m.
    """
    scene = city if isinstance(city, Scene) else prepare(city)
    camera = camera_for(_shown(scene.city, paths, transmitters, receivers) - scene.origin_m)
    picture = render(scene, camera, width)
    with context():
        figure = Figure(figsize=(width / 160, picture.shape[0] / 160))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.imshow(picture, extent=(0.0, 1.0, 0.0, 1.0), aspect="auto", interpolation="nearest")
        if paths is not None and transmitters is not None and receivers is not None:
            shown = some_rays(paths)
            for line, kind in zip(ray_lines(shown, transmitters, receivers), shown.kind, strict=True):
                axes.plot(*camera.project(line - scene.origin_m).T, color=KIND_COLOURS[kind], linewidth=0.7, alpha=0.7)
            axes.plot(*camera.project(transmitters - scene.origin_m).T, "^", color=VERMILLION, markeredgecolor=BLACK)
        names = dict.fromkeys(scene.city.materials[m].name for m in np.unique(scene.city.facets.material))
        axes.legend(
            handles=[Patch(facecolor=material_colour(n), edgecolor=GREY, label=n.replace("_", " ")) for n in names],
            loc="upper left",
        )
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(0.0, 1.0)
        axes.axis("off")
        figure.savefig(path)


def _buildings(figure: Figure, axes: Axes, city: City) -> None:
    order = np.argsort(city.heights_m, kind="stable")
    patches = PatchCollection(
        [PathPatch(_outline(city.footprints[i])) for i in order], cmap="YlOrBr", edgecolor="#8C8577", linewidth=0.3
    )
    patches.set_array(city.heights_m[order])
    patches.set_clim(0.0, 1.25 * float(city.heights_m.max(initial=1.0)))
    axes.add_collection(patches)
    figure.colorbar(patches, ax=axes, shrink=0.6, label="height (m)")


def _outline(polygon: Any) -> Outline:
    rings = [polygon.exterior, *polygon.interiors]
    return Outline.make_compound_path(*(Outline(np.asarray(ring.coords)[:, :2], closed=True) for ring in rings))


def _rays(axes: Axes, paths: Paths, transmitters: Floats, receivers: Floats) -> None:
    lines = ray_lines(paths, transmitters, receivers)
    for kind in np.unique(paths.kind)[::-1].tolist():
        chosen = [line[:, :2] for line, own in zip(lines, paths.kind, strict=True) if own == kind]
        style: dict[str, Any] = {"colors": KIND_COLOURS[kind], "label": KIND_NAMES[kind]}
        axes.add_collection(LineCollection(chosen, linewidths=0.4, alpha=0.5, **style))


def _shown(city: City, paths: Paths | None, transmitters: Floats | None, receivers: Floats | None) -> Floats:
    """Return the points (N, 3) that a picture must show: rays and their ends, or else all buildings."""
    ends = [p for p in (transmitters, receivers) if p is not None and len(p)]
    if paths is not None and ends:
        corners = paths.points_m.reshape(-1, 3)
        return np.concatenate([*ends, corners[~np.isnan(corners[:, 0])]])
    chosen = city.facets.building[city.triangle_facet] != GROUND
    return np.asarray(city.vertices[np.unique(city.triangles[chosen] if chosen.any() else city.triangles)], np.float64)


def _extent(points: Floats) -> tuple[Floats, Floats]:
    """Return the lower and upper corner of what holds the points (N, 2), with a margin, neither side very short."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    half = np.maximum(1.05 * half, 0.4 * half.max()) + 5.0
    return (low + high) / 2 - half, (low + high) / 2 + half
