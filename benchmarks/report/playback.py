"""The viewer's page of one recording and an estimate: the drive is played back, with the paths that were measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.figures.style import colour_of
from cellslam.benchmarks.report.page import write_page
from cellslam.benchmarks.report.scene import box_of, rounded, scene_of, vehicles_of
from cellslam.benchmarks.report.worst_trials import estimate_curves
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.sweeps.trajectories import trajectory
from cellslam.sim.errors import InputError
from cellslam.sim.frames import rotation, unit_vector
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.sim.traffic import traffic_of

if TYPE_CHECKING:
    from cellslam.sim.world import World

STEP_S, FEWEST, MOST = 1.0, 240, 1800  # from step to step; steps
UNKNOWN_M = 20.0  # how far a path is drawn whose distance was not measured
POINTS = 2000


def write_playback(recording: Recording, result: TrialResult, path: Path) -> None:
    """Write the page of a recording: city if it was simulated, truth or reference, estimate, measured paths.

    Raises InputError without plotly.
    """
    write_page(path, content(recording, result))


def content(recording: Recording, result: TrialResult) -> dict[str, Any]:
    """Return what the page shows. A path is drawn from the estimated pose to where its distance, less the estimated
    clock offset, and its angles point."""
    steps = _steps(recording)
    world = world_of(recording)
    scene, city = scene_of(world, steps) if world is not None else (_bare(recording, result, steps), None)
    scene |= {"measured": [_measured(recording, result, int(t)) for t in steps], "city": "city" if city else None}
    length, name = np.ptp(recording.time_s), result.estimator
    every = length / max(len(steps) - 1, 1)
    section = {
        "time": rounded(recording.elapsed_s[steps], 2),
        "estimates": [{"label": name, **estimate_curves(trajectory(recording, result, None), steps)}],
        "bound": [],
        "scene": scene,
    }
    return {
        "title": f"Playback: {name}",
        "lead": f"{len(recording.time_s)} snapshots in {length:.0f} s; a step is {every:.1f} s.",
        "series": [{"label": name, "oracle": result.oracle, "colour": colour_of(name), "dash": "solid"}],
        "heading": "Drive",
        "trials": [section],
        "cities": {"city": city} if city else {},
    }


def _steps(recording: Recording) -> Ints:
    """Return the snapshots that are shown, about one a second."""
    count = int(np.clip(np.ptp(recording.time_s) / STEP_S, FEWEST, MOST))
    even = np.linspace(recording.time_s[0], recording.time_s[-1], count)
    return np.unique(np.clip(np.searchsorted(recording.time_s, even), 0, len(recording.time_s) - 1))


def world_of(recording: Recording) -> World | None:
    """Return the world that a recording was simulated in, made again; None for others, or where it comes out otherwise
    than it was."""
    from cellslam.scenarios.recording_origin import Origin
    from cellslam.sim.world import prepare

    origin = Origin.of(recording)
    if origin.scenario is None or recording.truth is None:
        return None
    try:
        world = prepare(origin.scenario.world, origin.seed, origin.trial)
    except InputError:
        return None
    poses, same = world.drive.poses, recording.truth.poses
    return world if poses.shape == same.shape and np.allclose(poses, same, atol=1e-6) else None


def _bare(recording: Recording, result: TrialResult, steps: Ints) -> dict[str, Any]:
    """Return the scene of a recording without a city."""
    truth, shown = recording.truth, [result.poses[:, :3]]
    scene: dict[str, Any] = {"sites": [], "site_positions": [[], [], []]}
    if truth is not None:
        scene |= {"sites": list(recording.sites.name), "site_positions": rounded(truth.site_positions_m.T, 1)}
        scene["truth"] = rounded(truth.poses[steps, :3].T, 2)
        shown += [truth.poses[:, :3], truth.site_positions_m]
    elif recording.reference is not None:
        fixes = recording.reference.position_m
        fixes = fixes[:: len(fixes) // POINTS + 1]
        scene["reference"] = rounded(fixes.T, 2)
        shown.append(fixes)
    scene["box"] = rounded(box_of(np.concatenate(shown)).T, 0)
    scene["vehicles"] = vehicles_of(traffic_of(recording), recording.elapsed_s[steps])
    return scene


def _measured(recording: Recording, result: TrialResult, t: int) -> list[float]:
    """Return x, y, z of the far end of each path measured at snapshot t, one after the other."""
    pose, m, rows = result.poses[t], recording.measurements, recording.rows
    part = slice(rows[t], rows[t + 1])
    offset = 0.0 if result.clock_offset_m is None else result.clock_offset_m[t][recording.links.site[m.link[part]]]
    length = np.nan_to_num(m.distance_m[part] - offset, nan=UNKNOWN_M)
    body = unit_vector(m.azimuth_rad[part], np.nan_to_num(m.elevation_rad[part]))
    ends: Floats = pose[:3] + length[:, None] * (body @ rotation(*pose[3:]).T)
    return [float(value) for value in rounded(ends[~np.isnan(ends[:, 0])].ravel(), 1)]
