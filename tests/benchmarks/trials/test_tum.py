"""The TUM export, read back by hand and by SciPy's rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cellslam.benchmarks.trials.output_files import write_tum
from cellslam.sim.frames import rotation


def test_a_file_is_read_back(tmp_path):
    path = tmp_path / "out.tum"
    turns = np.random.default_rng(1).uniform(-np.pi, np.pi, (200, 3))
    poses = np.column_stack([np.tile([1.5, -2, 0.25], (200, 1)), turns])
    write_tum(path, 0.075 * np.arange(200), poses)
    lines = path.read_text().splitlines()
    assert lines[0] == "# timestamp tx ty tz qx qy qz qw"
    assert lines[2].split()[:4] == ["0.075000", "1.500000", "-2.000000", "0.250000"]
    q = np.loadtxt(path)[:, 4:]
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), rotation(*turns.T), atol=1e-8)
    assert (q[:, 3] >= 0).all()
