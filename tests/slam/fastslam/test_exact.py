"""The marginalised nuisances against one joint Kalman filter, in a linear world where both are exact."""

import numpy as np

from cellslam.slam.fastslam.snapshot import nuisance_kernel, pair_kernel, update_kernel
from cellslam.slam.fastslam.state.layout import (
    GAIN,
    LANES,
    MU,
    O_A,
    O_H,
    O_MU,
    O_S,
    OUT,
    SIGMA,
    THETA0,
    V_WEIGHT,
    W_E,
    W_MASK,
    W_ROWS,
    W_THETA,
    sums_of,
)

UPPER = np.triu_indices(3)
LOG_2PI = np.log(2 * np.pi)


def row(w: np.ndarray, first: int, values: np.ndarray) -> None:
    values = np.atleast_1d(np.asarray(values, float))
    w.reshape(-1, LANES)[first : first + len(values)] = values[:, None]


def read(w: np.ndarray, first: int, count: int) -> np.ndarray:
    return w.reshape(-1, LANES)[first : first + count, 7].copy()


def test_marginalised_offset_bias_and_scale_agree_with_a_joint_filter():
    """Two VTs of one site, 40 snapshots: means, covariances and the likelihood of all data agree to 1e-9."""
    rng = np.random.default_rng(11)
    size = 3  # one site: offset, bias, scale
    w, out, v = np.zeros(W_ROWS * LANES), np.zeros(OUT * LANES), np.zeros(sums_of(size).rows * LANES)
    theta, p = np.array([3.0, 0.01, -0.02]), np.diag([25.0, 1e-3, 4e-3])
    records, joint_mean = [], [theta]
    blocks = []
    for _ in range(2):
        root = rng.normal(size=(3, 3)) * [[0.5], [0.02], [0.02]]
        sigma, gain = root @ root.T, rng.normal(size=(3, 3)) * [[1, 5, 5], [0.01, 0.5, 0.5], [0.01, 0.5, 0.5]]
        mean = np.array([rng.uniform(50, 90), rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)])
        record = np.zeros(27 * LANES)
        row(record, MU, [mean[0], np.cos(mean[1]), np.sin(mean[1]), np.cos(mean[2]), np.sin(mean[2])])
        row(record, SIGMA, sigma[UPPER])
        row(record, GAIN, gain.ravel())
        row(record, THETA0, theta)
        records.append(record)
        joint_mean.append(mean)
        blocks.append((sigma, gain))
    dims = 3 + 3 * len(blocks)
    cov = np.zeros((dims, dims))
    stack = np.vstack([np.eye(3), *[g for _, g in blocks]])
    cov += stack @ p @ stack.T
    for i, (sigma, _) in enumerate(blocks):
        cov[3 + 3 * i : 6 + 3 * i, 3 + 3 * i : 6 + 3 * i] += sigma
    mean_all = np.concatenate(joint_mean)
    evidence = found = 0.0
    q = np.array([0.3, 4e-4, 4e-4])
    for _ in range(40):
        nuisance_kernel.forget(w, v, size)
        rows_all, residuals = [], []
        row(w, W_THETA, theta)
        for i, record in enumerate(records):
            h = np.eye(3) + rng.normal(size=(3, 3)) * [[0.1, 10, 10], [1e-3, 0.1, 0.1], [1e-3, 0.1, 0.1]]
            extra = rng.normal(size=(3, 3)) * [[0, 5, 5], [0, 0.1, 0.1], [0, 0.1, 0.1]]
            extra[0, 0] = 1.0  # e_d e_b^T, and what the pose owes to bias and scale
            z = h @ mean_all[3 + 3 * i : 6 + 3 * i] + extra @ mean_all[:3] + rng.normal(size=3) * np.sqrt(q) * 2
            full = np.zeros((3, dims))
            full[:, :3], full[:, 3 + 3 * i : 6 + 3 * i] = extra, h
            rows_all.append(full)
            residuals.append(z - full @ mean_all)
            gain = read(record, GAIN, 9).reshape(3, 3)
            sigma = np.zeros((3, 3))
            sigma[UPPER] = read(record, SIGMA, 6)
            sigma = sigma + sigma.T - np.diag(np.diag(sigma))
            c = read(record, MU, 5)
            mu = np.array([c[0], np.arctan2(c[2], c[1]), np.arctan2(c[4], c[3])])
            mu = mu + gain @ (theta - read(record, THETA0, 3))
            row(out, O_H, h.ravel())
            row(out, O_A, (h @ gain + extra).ravel())
            row(out, O_S, (h @ sigma @ h.T)[UPPER])
            row(out, O_MU, [mu[0], np.cos(mu[1]), np.sin(mu[1]), np.cos(mu[2]), np.sin(mu[2])])
            row(w, W_E, z - h @ mu - extra @ theta)
            row(w, W_MASK, 1.0)
            numbers = np.array([0, 1, 0, 1, 0, *q, 1, 1, 1, 0.0])
            pair_kernel.invert(w, out, numbers, 0.0)
            pair_kernel.logarithm(w, w.view(np.int64))
            update_kernel.credit(w, v, out, 0.0, 1.0)
            nuisance_kernel.absorb(w, out)
            update_kernel.correct(w, record, out)
        nuisance_kernel.collect(w, v, 0, size)
        at = sums_of(size)
        row(v, at.cov, p.ravel())
        nuisance_kernel.condition(v, size)
        theta = theta + read(v, at.change, size)
        p = read(v, at.cov, size * size).reshape(size, size)
        found += read(v, V_WEIGHT, 1)[0]
        big, e = np.vstack(rows_all), np.concatenate(residuals)
        s = big @ cov @ big.T + np.diag(np.tile(q, 2))
        evidence += -0.5 * (e @ np.linalg.solve(s, e) + np.linalg.slogdet(s)[1] + len(e) * LOG_2PI)
        k = cov @ big.T @ np.linalg.inv(s)
        mean_all = mean_all + k @ e
        cov = cov - k @ s @ k.T
    assert np.allclose(theta, mean_all[:3], rtol=1e-9, atol=1e-9)
    assert np.allclose(p, cov[:3, :3], rtol=1e-8, atol=1e-11)
    assert abs(found - evidence) < 1e-7
    for i, record in enumerate(records):
        c, gain = read(record, MU, 5), read(record, GAIN, 9).reshape(3, 3)
        mu = np.array([c[0], np.arctan2(c[2], c[1]), np.arctan2(c[4], c[3])])
        mu = mu + gain @ (theta - read(record, THETA0, 3))
        assert np.allclose(mu, mean_all[3 + 3 * i : 6 + 3 * i], rtol=1e-9, atol=1e-9)
        sigma = np.zeros((3, 3))
        sigma[UPPER] = read(record, SIGMA, 6)
        sigma = sigma + np.triu(sigma, 1).T
        assert np.allclose(
            sigma + gain @ p @ gain.T, cov[3 + 3 * i : 6 + 3 * i, 3 + 3 * i : 6 + 3 * i], rtol=1e-7, atol=1e-11
        )
