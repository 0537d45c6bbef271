"""A recording played back with an estimate: one page that needs nothing but a browser (plotly, extra `report`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.figures.city_page import check_plotly
from cellslam.benchmarks.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, VEHICLES, VERMILLION
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Floats, Recording
from cellslam.sim.traffic import traffic_of

STEP_S, FEWEST, MOST = 1.0, 240, 1800  # from frame to frame; frames
POINTS = 2000


def write_page(recording: Recording, result: TrialResult, path: Path) -> None:
    """Write the page: plan with truth or reference, estimate, its final VTs, and the paths measured at each moment.

    A path is drawn from the estimated pose to where its distance (less the estimated clock offset) and angles point.
    """
    check_plotly()
    import plotly.graph_objects as go

    frames = int(np.clip(np.ptp(recording.time_s) / STEP_S, FEWEST, MOST))
    even = np.linspace(recording.time_s[0], recording.time_s[-1], frames)
    moments = np.unique(np.clip(np.searchsorted(recording.time_s, even), 0, len(recording.time_s) - 1))
    fixed = _fixed(go, recording, result)
    moving = [_moment(go, recording, result, int(t)) for t in moments]
    traffic = traffic_of(recording)
    if traffic is not None:
        boxes = traffic.outlines(recording.elapsed_s[moments])
        moving = [[_boxes(go, outlines), *rest] for outlines, rest in zip(boxes, moving, strict=True)]
    figure = go.Figure([*fixed, *moving[0]])
    places = list(range(len(fixed), len(fixed) + len(moving[0])))
    names = [f"{recording.time_s[t] - recording.time_s[0]:.1f}" for t in moments]
    figure.frames = [go.Frame(data=d, traces=places, name=n) for d, n in zip(moving, names, strict=True)]
    steps = [
        {
            "label": n,
            "method": "animate",
            "args": [[n], {"mode": "immediate", "frame": {"duration": 0, "redraw": False}}],
        }
        for n in names
    ]
    play = {"frame": {"duration": 50, "redraw": False}, "fromcurrent": True, "transition": {"duration": 0}}
    figure.update_layout(
        title=f"{result.estimator}: {len(recording.time_s)} snapshots, {np.ptp(recording.time_s):.0f} s",
        xaxis={"title": "x (m)"},
        yaxis={"title": "y (m)", "scaleanchor": "x"},
        sliders=[{"steps": steps, "currentvalue": {"prefix": "time (s): "}}],
        updatemenus=[
            {
                "type": "buttons",
                "buttons": [
                    {"label": "play", "method": "animate", "args": [None, play]},
                    {
                        "label": "stop",
                        "method": "animate",
                        "args": [[None], {"mode": "immediate", "frame": {"duration": 0}}],
                    },
                ],
            }
        ],
    )
    figure.write_html(str(path), include_plotlyjs=True)


def _fixed(go: Any, recording: Recording, result: TrialResult) -> list[Any]:
    out = []
    if recording.truth is not None:
        out.append(_line(go, recording.truth.poses[:, :2], "truth", BLACK))
    elif recording.reference is not None:
        x, y = _thinned(recording.reference.position_m[:, :2]).T
        style = {"color": BLACK, "size": 3}
        out.append(go.Scattergl(x=x.round(2), y=y.round(2), mode="markers", marker=style, name="reference"))
    out.append(_line(go, result.poses[:, :2], result.estimator, BLUE))
    if result.vts is not None and len(result.vts.id):
        x, y = result.vts.position_m[:, :2].T.round(2)
        text = [f"VT {i}, link {k}" for i, k in zip(result.vts.id, result.vts.link, strict=True)]
        marker = {"color": GREEN, "size": 6, "symbol": "diamond"}
        out.append(go.Scattergl(x=x, y=y, mode="markers", marker=marker, text=text, name="final VTs"))
    return out


def _moment(go: Any, recording: Recording, result: TrialResult, t: int) -> list[Any]:
    """Return the vehicle and its measured paths at snapshot t."""
    pose, m, rows = result.poses[t], recording.measurements, recording.rows
    part = slice(rows[t], rows[t + 1])
    offset = 0.0 if result.clock_offset_m is None else result.clock_offset_m[t][recording.links.site[m.link[part]]]
    range_m = np.nan_to_num(m.distance_m[part] - offset, nan=20.0)
    flat = range_m * np.cos(np.nan_to_num(m.elevation_rad[part]))
    direction = pose[3] + m.azimuth_rad[part]
    known = ~np.isnan(direction)
    ends = pose[:2] + flat[known, None] * np.column_stack([np.cos(direction[known]), np.sin(direction[known])])
    gap = np.full(len(ends), np.nan)
    x = np.column_stack([np.full(len(ends), pose[0]), ends[:, 0], gap]).ravel()
    y = np.column_stack([np.full(len(ends), pose[1]), ends[:, 1], gap]).ravel()
    rays = go.Scatter(x=x.round(2), y=y.round(2), mode="lines", line={"color": GREY, "width": 1}, name="measured paths")
    nose = pose[:2] + 4.0 * np.array([np.cos(pose[3]), np.sin(pose[3])])
    body = go.Scatter(
        x=[pose[0], nose[0]],
        y=[pose[1], nose[1]],
        mode="lines+markers",
        line={"color": VERMILLION, "width": 3},
        marker={"size": [10, 1], "color": ORANGE},
        name="vehicle",
    )
    return [rays, body]


def _boxes(go: Any, outlines: Floats) -> Any:
    """Return other vehicles with the corners (N, 4, 2) as one trace of closed outlines."""
    closed = np.concatenate([outlines, outlines[:, :1], np.full((len(outlines), 1, 2), np.nan)], axis=1)
    x, y = closed.reshape(-1, 2).T.round(2)
    style = {"line": {"color": VEHICLES, "width": 1}, "fill": "toself", "fillcolor": VEHICLES, "hoverinfo": "skip"}
    return go.Scatter(x=x, y=y, mode="lines", name="other vehicles", **style)


def _line(go: Any, points: Floats, name: str, colour: str) -> Any:
    x, y = _thinned(points).T.round(2)
    return go.Scattergl(x=x, y=y, mode="lines", line={"color": colour}, name=name)


def _thinned(points: Floats) -> Floats:
    return points[:: max(len(points) // POINTS, 1)]
