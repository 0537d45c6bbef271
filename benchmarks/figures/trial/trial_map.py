"""The map: buildings, sites, trajectories, VTs mapped back to the walls (the paper's Fig. 2).

`reflectors_of` says where each path was reflected, if it was reflected once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle

from cellslam.benchmarks.figures import style
from cellslam.benchmarks.scores.map_scores import Tracks, tracks_of
from cellslam.benchmarks.scores.metrics import duration_s
from cellslam.benchmarks.scores.reference_fixes import usable
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.sim.traffic import traffic_of
from cellslam.slam.model.walls import reflection_point

if TYPE_CHECKING:
    from cellslam.sim.city import City

ODOMETRY_ALONE = "dead-reckoning"
# A VT this near to its site is the site itself, seen in line of sight.
LINE_OF_SIGHT_M = 15.0
FEWEST_MEASUREMENTS = 40
SNAPSHOTS_PER_POINT = 40
MARGIN = 0.08
HEIGHT_IN, LEGEND_ROW_IN = 4.0, 0.17
LARGER = 1.15
FAR = 5.0  # of the drive's size, or of half of the VTs' distance: what lies beyond is not drawn
Extent = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Reflector:
    """Where the paths of one estimated VT were reflected, over the time in which it was measured.

    `points_m` (n, 3) on the wall, seen from the estimated `vehicle_m` (n, 3); `site_m` (3,) as estimated;
    `life_s`: for how long it was measured, gaps left out.
    """

    link: int
    site: int
    site_m: Floats
    points_m: Floats
    vehicle_m: Floats
    life_s: float


def draw(figure: Figure, city: City | None, recording: Recording, results: Mapping[str, TrialResult]) -> bool:
    """Draw the whole scene on the left, the drive magnified on the right; False if there is nothing.

    The scene of a simulated drive has sites and reflecting points, that of a measured one the final mirror images;
    where that is hardly larger than the drive, it is drawn alone. Both, and scatterers, are those of the first result
    with VTs, walls those of the first with walls. True scatterers are drawn where they were measured. The building that
    carries the longest-lived reflected VT is drawn darker.
    """
    tracks = {name: result.poses for name, result in results.items()}
    truth = recording.truth
    if truth is None and not tracks:
        return False
    mapped = next((reflectors_of(recording, r) for r in results.values() if r.vts is not None), [])
    drive = _square(_driven(recording, tracks))
    vts, scatterers = _mapped(recording, results, drive)
    sites = truth.site_positions_m[:, :2] if truth is not None else np.zeros((0, 2))
    seen = [sites, *(reflector.points_m[:, :2] for reflector in mapped), *vts.values()]
    scene = _square(np.concatenate([_driven(recording, tracks), *(poses[:, :2] for poses in tracks.values()), *seen]))
    alone = np.ptp(scene[0]) < LARGER * np.ptp(drive[0])
    figure.set_size_inches(0.6 * style.WIDTH_IN if alone else style.WIDTH_IN, HEIGHT_IN)
    panels = figure.subplots(1, 1 if alone else 2, squeeze=False)[0]
    for axes, extent in zip(panels, (scene, drive)[: len(panels)], strict=True):
        _buildings(axes, city, mapped)
        _reflecting_points(axes, recording, mapped)
        _longest_path(axes, mapped)
        for name, place in vts.items():
            axes.plot(*place.T, "x", color=style.VT, markersize=3, markeredgewidth=0.7, label=f"VTs of {name}")
        for label, marker, place in scatterers:
            axes.plot(*place.T, **marker, markersize=5, markeredgewidth=0.8, linestyle="none", zorder=3.5, label=label)
        _walls(axes, results)
        _trajectories(axes, recording, tracks)
        _traffic(axes, recording)
        _sites(axes, recording, extent)
        axes.set(xlim=extent[0], ylim=extent[1], aspect="equal", xlabel="east (m)")
        axes.grid(False)
    panels[0].set_ylabel("north (m)")
    panels[-1].set_title("the drive")
    if not alone:
        (x0, x1), (y0, y1) = drive
        frame = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, color=style.GREY, linewidth=0.8, linestyle=":")
        panels[0].add_patch(frame)
        panels[0].set_title("sites, reflecting walls" if truth is not None else "the map")
    handles, labels = panels[0].get_legend_handles_labels()
    columns = 2 if alone else 4
    figure.set_figheight(HEIGHT_IN + LEGEND_ROW_IN * -(-len(labels) // columns))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, markerscale=2)
    return True


def _driven(recording: Recording, tracks: Mapping[str, Floats]) -> Floats:
    """Return where the vehicle was (n, 2): truth or reference, and estimates, but odometry alone where others are."""
    others = {name: poses for name, poses in tracks.items() if name != ODOMETRY_ALONE} or tracks
    known = []
    if recording.truth is not None:
        known.append(recording.truth.poses[:, :2])
    elif recording.reference is not None:
        known.append(recording.reference.position_m[usable(recording, recording.reference), :2])
    return np.concatenate([*known, *(poses[:, :2] for poses in (tracks if recording.truth else others).values())])


def _mapped(
    recording: Recording, results: Mapping[str, TrialResult], drive: Extent
) -> tuple[dict[str, Floats], list[tuple[str, dict[str, Any], Floats]]]:
    """Return what is drawn of maps of VTs, in horizontal positions (n, 2).

    Of a measured drive the mirror images of the first result with VTs, by its name; then label, marker and positions of
    the true scatterers that were measured, and of that result's. VTs that lie far beyond the others are left out.
    """
    images, scatterers = dict[str, Floats](), list[tuple[str, dict[str, Any], Floats]]()
    if recording.truth is not None:
        vts, measured = recording.truth.vts, np.unique(recording.truth.measurement_vt)
        position = vts.position_m[np.intersect1d(np.flatnonzero(vts.scatters), measured), :2]
        circle = {"marker": "o", "markerfacecolor": "none", "color": style.TRUTH}
        scatterers.append(("true scatterers", circle, position))
    found = {name: result.vts for name, result in results.items() if result.vts is not None and len(result.vts.id)}
    if found:
        name, estimated = next(iter(found.items()))
        if recording.truth is None:
            images[name] = _near(estimated.position_m[~estimated.scatters, :2], drive)
        position = _near(estimated.position_m[estimated.scatters, :2], drive)
        scatterers.append((f"scatterers of {name}", {"marker": "+", "color": style.VT}, position))
    return images, [one for one in scatterers if len(one[2])]


def _near(position: Floats, drive: Extent) -> Floats:
    """Return those of the positions (n, 2) that are not five times as far off as half of them."""
    off = np.hypot(*(position - np.mean(drive, axis=1)).T)
    farthest = FAR * max(float(np.median(off)), float(np.ptp(drive[0]))) if len(off) else 0.0
    return np.asarray(position[off <= farthest])


def _walls(axes: Axes, results: Mapping[str, TrialResult]) -> None:
    for name, result in results.items():
        if result.walls is not None and len(result.walls):
            drawn: dict[str, Any] = {"colors": style.WALL, "linewidths": 2.0, "zorder": 3}
            axes.add_collection(
                LineCollection(list(result.walls.ends_m), label=f"walls of {name}", **drawn), autolim=False
            )
            return


def emphasised_building(city: City | None, mapped: Sequence[Reflector]) -> int | None:
    """Return the building nearest to the points of the longest-lived reflected VT, None without one."""
    if city is None or not city.footprints or not mapped:
        return None
    from shapely import STRtree, points

    nearest = STRtree(city.footprints).nearest(points(mapped[0].points_m[:, :2]))
    return int(np.bincount(nearest).argmax())


def _square(points: Floats) -> Extent:
    """Return x and y limits of a square that holds the points (n, 2), with a margin."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(0.5 * float((high - low).max()) * (1 + 2 * MARGIN), 5.0)
    x, y = (float(c) for c in 0.5 * (low + high))
    return (x - half, x + half), (y - half, y + half)


def _buildings(axes: Axes, city: City | None, mapped: Sequence[Reflector]) -> None:
    if city is None:
        return
    patches = [PathPatch(style.outline(footprint)) for footprint in city.footprints]
    axes.add_collection(PatchCollection(patches, facecolor=style.BUILDING, edgecolor="#C9C4BB", linewidth=0.4))
    chosen = emphasised_building(city, mapped)
    if chosen is not None:
        drawn: dict[str, Any] = {"facecolor": style.EMPHASIS, "edgecolor": style.BLACK, "linewidth": 1.0}
        label = "building of the longest-lived reflection"
        axes.add_patch(PathPatch(style.outline(city.footprints[chosen]), label=label, **drawn))


def _reflecting_points(axes: Axes, recording: Recording, mapped: Sequence[Reflector]) -> None:
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 3.5, "markeredgewidth": 0, "alpha": 0.6}
    for site in range(len(recording.sites)):
        points = [r.points_m[:, :2] for r in mapped if r.site == site]
        if points:
            x, y = np.concatenate(points).T
            label = f"reflecting points, site {recording.sites.name[site]}"
            axes.plot(x, y, **dots, color=style.SITES[site % len(style.SITES)], label=label)


def _longest_path(axes: Axes, mapped: Sequence[Reflector]) -> None:
    """Draw the path site - wall - vehicle of the longest-lived reflected VT in the middle of its life."""
    if mapped:
        first = mapped[0]
        middle = len(first.points_m) // 2
        path = np.stack([first.site_m, first.points_m[middle], first.vehicle_m[middle]])
        axes.plot(*path[:, :2].T, color=style.BLACK, linewidth=0.7, linestyle="-.", label="its path, half-way")


def _trajectories(axes: Axes, recording: Recording, tracks: Mapping[str, Floats]) -> None:
    if recording.truth is not None:
        axes.plot(*recording.truth.poses[:, :2].T, color=style.TRUTH, linewidth=2.4, label="true trajectory")
        axes.plot(*recording.truth.poses[0, :2], "o", color=style.TRUTH, markersize=4)
    elif recording.reference is not None:
        fixes = recording.reference.position_m[usable(recording, recording.reference), :2]
        axes.plot(*fixes.T, ".", color=style.TRUTH, markersize=2.5, label="reference")
    # Where lines meet, the first estimator's is seen, and the next one's on both sides of it.
    for place, (name, line) in enumerate(style.estimator_styles(tracks).items()):
        axes.plot(*tracks[name][:, :2].T, **{**line, "linewidth": 1.1 + 0.5 * place, "zorder": 2.9 - 0.1 * place})


def _traffic(axes: Axes, recording: Recording) -> None:
    """Draw the other vehicles where they are half-way, and where one of them blocks a line of sight."""
    traffic, truth = traffic_of(recording), recording.truth
    if traffic is None or truth is None or truth.vehicles is None:
        return
    middle = recording.elapsed_s[[len(recording.elapsed_s) // 2]]
    outlines = PolyCollection(
        list(traffic.outlines(middle)[0]), facecolor=style.VEHICLES, edgecolor="white", linewidth=0.3
    )
    outlines.set(zorder=3, label="vehicles, half-way")
    axes.add_collection(outlines, autolim=False)
    sights = truth.vehicles.blocked[truth.vts.order[truth.vehicles.blocked[:, 0]] == 0]
    blocked = np.zeros(len(truth.poses), np.bool_)
    for first, last in sights[:, 2:]:
        blocked[first : last + 1] = True
    if blocked.any():
        drawn: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4, "zorder": 4}
        drawn |= {"color": style.VEHICLES, "markeredgecolor": "white", "markeredgewidth": 0.5}
        axes.plot(*truth.poses[blocked, :2][::20].T, **drawn, label="a site behind a vehicle")


def _sites(axes: Axes, recording: Recording, extent: Extent) -> None:
    if recording.truth is None:
        return
    (x0, x1), (y0, y1) = extent
    for site, (x, y, _) in enumerate(recording.truth.site_positions_m):
        if x0 < x < x1 and y0 < y < y1:
            axes.plot(x, y, "^", color=style.SITES[site % len(style.SITES)], markeredgecolor=style.BLACK, markersize=8)
            axes.annotate(recording.sites.name[site], (x, y), xytext=(6, 5), textcoords="offset points", weight="bold")


def site_estimates(recording: Recording, result: TrialResult, tracks: Tracks) -> dict[int, Floats]:
    """Return each site's position (3,) in m: mean of the estimated VTs that stand for it, else the truth."""
    truth, vts, found = recording.truth, result.vts, {}
    if truth is None or vts is None:
        return {}
    for site in range(len(recording.sites)):
        direct = np.flatnonzero((truth.vts.order == 0) & (truth.vts.site == site))
        mine = np.isin(tracks.stands_for, direct) & (tracks.count >= FEWEST_MEASUREMENTS)
        pairs = set(zip(tracks.link[mine], tracks.id[mine], strict=True))
        rows = [k for k in range(len(vts.id)) if (vts.link[k], vts.id[k]) in pairs]
        found[site] = vts.position_m[rows].mean(axis=0) if rows else truth.site_positions_m[site]
    return found


def reflectors_of(recording: Recording, result: TrialResult) -> list[Reflector]:
    """Return the reflectors of a result's final mirror images, longest-lived first; none without truth, VTs or
    associations.

    Truth serves only to tell which VTs are sites. Vehicle positions are the estimated ones.
    """
    if recording.truth is None or result.vts is None or result.association is None:
        return []
    m, vts = recording.measurements, result.vts
    tracks = tracks_of(m.link, result.association, recording.truth.measurement_vt)
    sites = site_estimates(recording, result, tracks)
    interval_s = duration_s(recording) / len(recording.time_s)
    found = []
    for k in np.flatnonzero(~vts.scatters):
        track = np.flatnonzero((tracks.link == vts.link[k]) & (tracks.id == vts.id[k]))
        site = int(recording.links.site[vts.link[k]])
        near = np.linalg.norm(vts.position_m[k] - sites[site]) < LINE_OF_SIGHT_M
        if len(track) == 0 or near or tracks.count[track[0]] < FEWEST_MEASUREMENTS:
            continue
        seen = m.snapshot[np.flatnonzero(tracks.row_track == track[0])]
        vehicle = result.poses[_spread(seen), :3]
        points = reflection_point(sites[site], vts.position_m[k], vehicle)
        there = np.isfinite(points).all(axis=1)
        life_s = len(np.unique(seen)) * interval_s
        if there.any():
            link = int(vts.link[k])
            found.append(Reflector(link, site, sites[site], points[there], vehicle[there], life_s))
    return sorted(found, key=lambda r: -r.life_s)


def _spread(snapshots: Ints) -> Ints:
    """Return some of the snapshots: the first in each stretch of `SNAPSHOTS_PER_POINT`."""
    _, first = np.unique(snapshots // SNAPSHOTS_PER_POINT, return_index=True)
    return np.asarray(snapshots[first])
