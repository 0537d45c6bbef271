"""An interactive page of a city with its rays: one self-contained file that works offline."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.figures.city_pictures import ORDER_COLOURS, ORDER_NAMES, ray_lines, some_rays
from cellslam.benchmarks.figures.city_render import material_colour
from cellslam.benchmarks.figures.style import BLACK, VERMILLION
from cellslam.sim.city.city import City, Floats
from cellslam.sim.errors import InputError
from cellslam.sim.rays import Paths

SHOWN_RAYS = 4000
SHOWN_POINTS = 5000
EYE = {"x": -0.35, "y": -0.85, "z": 0.55}


def check_plotly() -> None:
    """Raise InputError unless plotly is installed."""
    from importlib.util import find_spec

    if find_spec("plotly") is None:
        raise InputError("interactive pages need plotly: pip install 'cellslam[report]'")


def write_html(path: Path, city: City, paths: Paths, transmitters: Floats, receivers: Floats) -> None:
    """Write the page. Rays are grouped by order, for the legend to switch them; at most 4000 are drawn.

    Transmitters (S, 3) and receivers (N, 3) in m. Raises InputError where plotly is not installed.
    """
    check_plotly()
    import plotly.graph_objects as go

    origin = np.append(city.bounds.mean(axis=0)[:2], 0.0)
    figure = go.Figure([*_surfaces(go, city, origin)])
    shown = some_rays(paths, SHOWN_RAYS)
    lines = ray_lines(shown, transmitters, receivers)
    for order in range(int(shown.order.max(initial=-1)) + 1):
        x, y, z = _joined([line - origin for line, o in zip(lines, shown.order, strict=True) if o == order])
        style = {"color": ORDER_COLOURS[order], "width": 2}
        name = f"{ORDER_NAMES[order]} ({np.count_nonzero(paths.order == order)})"
        figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="lines", line=style, name=name, hoverinfo="skip"))
    figure.add_trace(_markers(go, "transmitter", transmitters, origin, VERMILLION, 6.0))
    figure.add_trace(_markers(go, "receiver", receivers, origin, BLACK, 1.5))
    figure.update_layout(
        title=f"{city.name}: {len(paths)} paths" + (f", {len(shown)} drawn" if len(shown) < len(paths) else ""),
        scene={"aspectmode": "data", "xaxis_title": f"x - {origin[0]:.1f} (m)",
               "yaxis_title": f"y - {origin[1]:.1f} (m)", "zaxis_title": "z (m)", "camera": {"eye": EYE}},
        margin={"l": 0, "r": 0, "b": 0, "t": 40},
    )  # fmt: skip
    figure.write_html(str(path), include_plotlyjs=True, default_height="97vh")


def _surfaces(go: Any, city: City, origin: Floats) -> list[Any]:
    """Return one mesh per name of a material; corners are rounded to a centimetre to keep the file small."""
    label = np.array([m.name for m in city.materials])[city.facets.material[city.triangle_facet]]
    surfaces = []
    for name in np.unique(label).tolist():
        used, renumbered = np.unique(city.triangles[label == name], return_inverse=True)
        i, j, k = renumbered.reshape(-1, 3).astype(np.int32).T
        x, y, z = np.round(city.vertices[used] - origin, 2).astype(np.float32).T
        colour = "rgb({:.0f},{:.0f},{:.0f})".format(*(255 * np.array(material_colour(name))))
        surfaces.append(
            go.Mesh3d(
                x=x, y=y, z=z, i=i, j=j, k=k, color=colour, name=name.replace("_", " "), flatshading=True,
                showlegend=True, hoverinfo="skip",
            )
        )  # fmt: skip
    return surfaces


def _markers(go: Any, name: str, points: Floats, origin: Floats, colour: str, size: float) -> Any:
    """Return points with their number and place as text; of very many every n-th."""
    rows = np.arange(0, len(points), len(points) // SHOWN_POINTS + 1)
    x, y, z = np.round(points[rows] - origin, 2).T
    text = [f"{name} {row}<br>{', '.join(f'{c:.2f}' for c in points[row])} m" for row in rows]
    marker = {"size": size, "color": colour}
    return go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, name=f"{name}s", text=text, hoverinfo="text")


def _joined(lines: list[Floats]) -> tuple[Floats, Floats, Floats]:
    """Return x, y, z of all lines, one after the other, NaN between them."""
    gap = np.full((1, 3), np.nan)
    pieces = [piece for line in lines for piece in (np.round(line, 2), gap)] or [gap]
    x, y, z = np.concatenate(pieces).astype(np.float32).T
    return x, y, z
