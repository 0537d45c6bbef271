"""The measurement model's Jacobians."""

import numpy as np

from cellslam.slam.model.measurement_model import jacobians, predict


def test_model_jacobians_against_differences():
    rng = np.random.default_rng(0)
    pose, vt = np.concatenate([rng.normal(0, 20, 3), [2.9, 0.2, -0.3]]), rng.normal(0, 100, 3)
    by_vt, by_pose = jacobians(pose, vt)
    for i in range(3):
        step = 1e-5 * np.eye(3)[i]
        assert np.allclose(by_vt[:, i], (predict(pose, vt + step) - predict(pose, vt - step)) / 2e-5, atol=1e-7)
    for i in range(6):
        step = 1e-6 * np.eye(6)[i]
        assert np.allclose(by_pose[:, i], (predict(pose + step, vt) - predict(pose - step, vt)) / 2e-6, atol=1e-6)
