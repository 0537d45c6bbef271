"""An estimate aligned with the truth: for campaigns whose start is arbitrary. Done on request only; results say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellslam.benchmarks.scores.reference_fixes import compared
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.errors import InputError
from cellslam.sim.frames import rotation, wrap_angle
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import WallEstimate
from cellslam.slam.model.walls import normals


def aligned(recording: Recording, result: TrialResult) -> TrialResult:
    """Return the estimate turned and shifted in the horizontal plane so that its positions fit the truth best.

    Poses, covariances, VTs and walls move as one. Raises InputError where the truth or reference has too few positions.
    """
    found = compared(recording, result.poses)
    if found is None:
        raise InputError("cannot align: the recording has neither truth nor reference")
    _, estimated, known = found
    if len(known) < 2:
        raise InputError("cannot align: the reference has fewer than two positions within the drive")
    angle, shift = rigid(estimated, known)
    turn = rotation(angle, 0.0, 0.0)
    offset = np.append(shift, 0.0)
    both = np.eye(6)
    both[:3, :3] = turn
    poses = result.poses.copy()
    poses[:, :3] = poses[:, :3] @ turn.T + offset
    poses[:, 3] = wrap_angle(poses[:, 3] + angle)
    vts = result.vts
    if vts is not None:
        vts = replace(vts, position_m=vts.position_m @ turn.T + offset, covariance=turn @ vts.covariance @ turn.T)
    walls = None if result.walls is None else _moved(result.walls, angle, shift)
    return replace(result, poses=poses, covariances=both @ result.covariances @ both.T, vts=vts, walls=walls)


def _moved(walls: WallEstimate, angle: float, shift: Floats) -> WallEstimate:
    """Return walls that were turned by an angle (rad), then shifted (2,) in m."""
    azimuth = wrap_angle(walls.azimuth_rad + angle)
    across, along = normals(azimuth)
    by = np.tile(np.eye(2), (len(walls), 1, 1))
    by[:, 1, 0] = along @ shift
    return replace(
        walls,
        azimuth_rad=azimuth,
        distance_m=walls.distance_m + across @ shift,
        covariance=by @ walls.covariance @ np.swapaxes(by, 1, 2),
        extent_m=walls.extent_m + (along @ shift)[:, None],
    )


def rigid(points: Floats, onto: Floats) -> tuple[float, Floats]:
    """Return angle (rad) and shift (2,) of the rigid motion in the plane that takes points (N, 2) in m best onto
    others.

    Source: S. Umeyama, Least-squares estimation of transformation parameters, 1991, in two dimensions without scale.
    """
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    angle = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    c, s = np.cos(angle), np.sin(angle)
    return angle, onto.mean(axis=0) - np.array([[c, -s], [s, c]]) @ points.mean(axis=0)
