"""Covariances of poses as other tools have them: of a rotation vector, not of angles; beside a TUM file, or in SQUARE.

cellslam's are of [x, y, z, psi, theta, phi]. An angle turns the vehicle about its axis: psi about the world's z, theta
about y after that turn, phi about the body's x. With W of these axes the rotation vector is W d(angles) in the world,
and R^T W d(angles) in the body.

Sources: Barfoot and Furgale, "Associating uncertainty with three-dimensional poses for use in estimation problems",
IEEE Trans. Robotics 30(3), 2014 (perturbations on the right: T = mean Exp(xi)); SQUARE and the side file are those of
the tool smfeval.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np

from cellslam.benchmarks.trials.output_files import quaternions
from cellslam.sim.frames import rotation
from cellslam.sim.recording import Floats

LOWER = np.tril_indices(6)


def in_world(poses: Floats, covariances: Floats) -> Floats:
    """Return the covariances (T, 6, 6) of position and rotation vector, both in the world frame, of poses (T, 6)."""
    return _turned(np.tile(np.eye(3), (len(poses), 1, 1)), poses, covariances)


def in_body(poses: Floats, covariances: Floats) -> Floats:
    """Return the covariances (T, 6, 6) of translation and rotation vector in the body frame, of poses (T, 6): of
    perturbations on the right."""
    return _turned(np.swapaxes(rotation(*poses[:, 3:].T), 1, 2), poses, covariances)


def write_square(path: Path, name: str, time_s: Floats, poses: Floats, covariances: Floats) -> None:
    """Write poses (T, 6) with covariances (T, 6, 6) at `time_s` (T,) as SQUARE, the format of smfeval."""
    head = {
        "FORMAT": "SQUARE/0.3", "REPRESENTATION": "gaussian_se3", "POSE_FRAME": "world", "BODY_FRAME": "vehicle",
        "GAUGE": "fixed", "TIMESTAMP_UNIT": "seconds", "ALGORITHM": name, "ALGORITHM_VERSION": version("cellslam"),
        "TANGENT_CONVENTION": "right_perturbation", "TANGENT_ORDER": "translation_rotation",
        "ROTATION_PARAM": "axis_angle",
    }  # fmt: skip
    table = np.column_stack([time_s, poses[:, :3], quaternions(poses), _lower(poses, covariances)])
    lines = "\n".join(f"#%{key} {value}" for key, value in head.items())
    np.savetxt(path, table, fmt=["%.9f", *["%.17g"] * 28], header=lines, comments="")


def write_side_file(path: Path, time_s: Floats, poses: Floats, covariances: Floats) -> None:
    """Write the covariances (T, 6, 6) of the poses (T, 6) in a TUM file: time, and the lower triangle row by row."""
    lines = "#%TANGENT_CONVENTION right_perturbation\n#%TANGENT_ORDER translation_rotation"
    table = np.column_stack([time_s, _lower(poses, covariances)])
    np.savetxt(path, table, fmt=["%.6f", *["%.17g"] * 21], header=lines, comments="")


def _lower(poses: Floats, covariances: Floats) -> Floats:
    return in_body(poses, covariances)[:, LOWER[0], LOWER[1]]


def _turned(of_position: Floats, poses: Floats, covariances: Floats) -> Floats:
    """Return J P J^T, with J of what `of_position` (T, 3, 3) does to positions, and then to rotations in the world."""
    psi, theta, phi = poses[:, 3:].T
    zero = np.zeros(len(poses))
    up = np.tile([0.0, 0.0, 1.0], (len(poses), 1))
    axes = np.stack([up, rotation(psi, zero, zero)[:, :, 1], rotation(psi, theta, phi)[:, :, 0]], axis=2)
    J = np.zeros((len(poses), 6, 6))
    J[:, :3, :3], J[:, 3:, 3:] = of_position, of_position @ axes
    return np.asarray(J @ covariances @ np.swapaxes(J, 1, 2))
