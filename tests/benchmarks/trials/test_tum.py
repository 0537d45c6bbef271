"""The TUM export, read back by hand and by SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellslam.benchmarks.trials.output_files import quaternions, write_tum
from cellslam.sim.frames import rotation


def test_quaternions_turn_vectors_like_the_rotation_matrix():
    poses = np.random.default_rng(1).uniform(-np.pi, np.pi, (200, 6))
    q = quaternions(poses)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), rotation(*poses[:, 3:].T), atol=1e-12)
    assert (q[:, 3] >= 0).all()


def test_file_by_worked_numbers(tmp_path):
    path = tmp_path / "out.tum"
    poses = np.array([[1.5, -2, 0.25, 0, 0, 0], [2, 0, 0, np.pi / 2, 0, 0]])
    write_tum(path, np.array([0.0, 0.075]), poses)
    lines = path.read_text().splitlines()
    assert lines[0] == "# timestamp tx ty tz qx qy qz qw"
    assert lines[1].split()[:4] == ["0.000000", "1.500000", "-2.000000", "0.250000"]
    table = np.loadtxt(path)
    np.testing.assert_allclose(table[:, 4:], [[0, 0, 0, 1], [0, 0, 0.5**0.5, 0.5**0.5]], atol=1e-9)


def test_evo_reads_the_file(tmp_path):
    pytest.importorskip("evo", reason="evo is not installed (GPL-3, never a dependency)")
    from evo.tools import file_interface  # type: ignore[import-not-found]

    path = tmp_path / "out.tum"
    write_tum(path, np.arange(5) * 0.075, np.random.default_rng(2).normal(0, 1, (5, 6)))
    assert file_interface.read_tum_trajectory_file(str(path)).num_poses == 5
