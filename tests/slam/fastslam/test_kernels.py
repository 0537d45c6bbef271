"""The compiled kernels against plain linear algebra, lane by lane."""

import numpy as np
import pytest

from cellslam.sim.frames import rotation, unit_vector
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.choice import chosen
from cellslam.slam.fastslam.snapshot import nuisance_kernel, pair_kernel, predict_kernel, update_kernel
from cellslam.slam.fastslam.state.layout import (
    ANCHOR,
    GAIN,
    LANES,
    MU,
    O_A,
    O_H,
    O_S,
    OUT,
    RECORD,
    SIGMA,
    THETA0,
    V_WEIGHT,
    V_Y,
    W_D2,
    W_DET,
    W_E,
    W_G,
    W_LOG,
    W_MASK,
    W_P,
    W_POSE,
    W_ROT,
    W_ROWS,
    W_THETA,
    sums_of,
)
from cellslam.slam.model.measurement_model import predict as h

PARTS = chosen(FastSlamOptions(errors="counted")).parts


class Lanes:
    """The kernels' arrays, whose rows are read and written by name, all lanes with different numbers."""

    def __init__(self, nuisances: int = 4) -> None:
        rows = {"w": W_ROWS, "rec": RECORD, "out": OUT, "v": sums_of(nuisances).rows}
        self.w, self.rec, self.out, self.v = (np.zeros(n * LANES) for n in rows.values())

    def get(self, where: str, row: int, count: int) -> np.ndarray:
        return getattr(self, where).reshape(-1, LANES)[row : row + count].T.copy()

    def set(self, where: str, row: int, values: np.ndarray) -> None:
        values = np.asarray(values, float)
        rows = getattr(self, where).reshape(-1, LANES)
        rows[row : row + values.shape[-1]] = np.broadcast_to(values, (LANES, values.shape[-1])).T


def measurement(d, az, el, q=(0.3, 1e-4, 4e-4), flags=(1, 1, 1)):
    return np.array([d, np.cos(az), np.sin(az), np.cos(el), np.sin(el), *q, *flags, 0.0, az])


def scene(seed: int) -> tuple[Lanes, dict[str, np.ndarray]]:
    """Fill pose, nuisances and a record with random numbers; theta equals theta0 plus a small change."""
    rng = np.random.default_rng(seed)
    lanes = Lanes()
    pose = np.column_stack([rng.normal(0, 30, (LANES, 3)), rng.uniform(-3, 3, LANES), rng.normal(0, 0.1, (LANES, 2))])
    r = rotation(*pose[:, 3:].T)
    root = rng.normal(size=(LANES, 3, 3))
    spread = root @ np.swapaxes(root, 1, 2) * [[1, 0.01, 0.01], [0.01, 1e-4, 1e-4], [0.01, 1e-4, 1e-4]]
    root = rng.normal(size=(LANES, 3, 3))
    theta_cov = root @ np.swapaxes(root, 1, 2) * [[9, 0.003, 0.03], [0.003, 1e-6, 1e-5], [0.03, 1e-5, 1e-4]]
    upper = np.triu_indices(3)
    parts = {
        "pose": pose,
        "pose_g": rng.normal(0, 10, (LANES, 6)) * [1, 1, 1, 1, 3, 0.1],
        "theta": np.column_stack([rng.normal(0, 50, LANES), rng.normal(0, 1e-3, LANES), rng.normal(0, 0.01, LANES)]),
        "anchor": pose[:, :3] + rng.normal(0, 5, (LANES, 3)),
        "range": rng.uniform(50, 500, LANES),
        "az": rng.uniform(-3, 3, LANES),
        "el": rng.uniform(-0.4, 0.6, LANES),
        "gain": rng.normal(0, 1, (LANES, 3, 3)) * [[0.5, 50, 20], [1e-3, 1, 0.1], [1e-3, 0.5, 0.1]],
        "sigma": spread,
        "cov": theta_cov,
    }
    lanes.set("w", W_POSE, pose)
    lanes.set("w", W_G, parts["pose_g"])
    lanes.set("w", W_ROT, r.reshape(LANES, 9))
    lanes.set("w", W_THETA, parts["theta"])
    lanes.set("rec", THETA0, parts["theta"])
    lanes.set("w", W_P, theta_cov[:, *upper])
    lanes.set("rec", ANCHOR, parts["anchor"])
    az, el = parts["az"], parts["el"]
    lanes.set("rec", MU, np.column_stack([parts["range"], np.cos(az), np.sin(az), np.cos(el), np.sin(el)]))
    lanes.set("rec", SIGMA, spread[:, *upper])
    lanes.set("rec", GAIN, parts["gain"].reshape(LANES, 9))
    return lanes, parts


def measured(parts, ds, dtheta, lane):
    """Return h + offset of one lane for a VT displaced by ds and nuisances changed by dtheta."""
    p = parts
    g = p["pose_g"][lane].reshape(3, 2)
    pose = p["pose"][lane].copy()
    pose[[0, 1, 3]] += g @ dtheta[1:]
    s = np.array([p["range"][lane], p["az"][lane], p["el"][lane]]) + ds + p["gain"][lane] @ dtheta
    vt = p["anchor"][lane] + s[0] * unit_vector(s[1], s[2])
    return h(pose, vt) + np.array([p["theta"][lane, 0] + dtheta[0], 0, 0])


def test_prediction_has_the_derivatives_of_the_model():
    lanes, parts = scene(1)
    predict_kernel.predict(PARTS, lanes.w, lanes.rec, lanes.out)
    hs = lanes.get("out", O_H, 9).reshape(LANES, 3, 3)
    a = lanes.get("out", O_A, 9).reshape(LANES, 3, 3)
    for lane in range(LANES):
        for c in range(3):
            step, zero = np.zeros(3), np.zeros(3)
            step[c] = (1e-3, 1e-6, 1e-6)[c]
            by_s = (measured(parts, step, zero, lane) - measured(parts, -step, zero, lane)) / (2 * step[c])
            by_theta = (measured(parts, zero, step, lane) - measured(parts, zero, -step, lane)) / (2 * step[c])
            assert np.allclose(hs[lane, :, c], by_s, rtol=1e-5, atol=1e-7)
            assert np.allclose(a[lane, :, c], by_theta, rtol=2e-5, atol=1e-6)
    upper = np.triu_indices(3)
    s = (hs @ parts["sigma"] @ np.swapaxes(hs, 1, 2))[:, *upper]
    assert np.allclose(lanes.get("out", O_S, 6), s, rtol=1e-9, atol=1e-15)


def test_innovation_is_the_wrapped_difference_at_any_azimuth():
    lanes, parts = scene(2)
    predict_kernel.predict(PARTS, lanes.w, lanes.rec, lanes.out)
    for shift in (0.0, 0.4, -0.9):
        lane = 5
        z = measured(parts, np.zeros(3), np.zeros(3), lane)
        z = z + np.array([1.5, shift, 0.1])
        pair_kernel.innovate(lanes.w, lanes.out, measurement(*z))
        assert np.allclose(lanes.get("w", W_E, 3)[lane], [1.5, shift, 0.1], atol=1e-9)


def test_a_component_that_was_not_measured_takes_no_part():
    lanes, parts = scene(3)
    predict_kernel.predict(PARTS, lanes.w, lanes.rec, lanes.out)
    z = measurement(300.0, 0.2, 0.1, q=(0.3, 1e-4, 1.0), flags=(1, 1, 0))
    pair_kernel.innovate(lanes.w, lanes.out, z)
    pair_kernel.invert(lanes.w, lanes.out, z, 1.0)
    e, d2, det = lanes.get("w", W_E, 3), lanes.get("w", W_D2, 1)[:, 0], lanes.get("w", W_DET, 1)[:, 0]
    hs, a = lanes.get("out", O_H, 9).reshape(LANES, 3, 3), lanes.get("out", O_A, 9).reshape(LANES, 3, 3)
    s = hs @ parts["sigma"] @ np.swapaxes(hs, 1, 2) + a @ parts["cov"] @ np.swapaxes(a, 1, 2)
    two = s[:, :2, :2] + np.diag(z[5:7])
    assert np.allclose(det, np.linalg.det(two), rtol=1e-9)
    assert np.allclose(d2, np.einsum("li,lij,lj->l", e[:, :2], np.linalg.inv(two), e[:, :2]), rtol=1e-8)
    assert np.all(e[:, 2] == 0.0)


def test_correction_is_the_kalman_update_and_leaves_masked_lanes_alone():
    lanes, parts = scene(4)
    predict_kernel.predict(PARTS, lanes.w, lanes.rec, lanes.out)
    hs = lanes.get("out", O_H, 9).reshape(LANES, 3, 3)
    z = measurement(parts["range"][0] + parts["theta"][0, 0], 0.3, 0.05)
    pair_kernel.innovate(lanes.w, lanes.out, z)
    lanes.set("w", W_E, lanes.get("w", W_E, 3) * 1e-3)
    pair_kernel.invert(lanes.w, lanes.out, z, 0.0)
    mask = (np.arange(LANES) % 2).astype(float)
    lanes.set("w", W_MASK, mask[:, None])
    before = lanes.get("rec", 0, 27)
    e, a = lanes.get("w", W_E, 3), lanes.get("out", O_A, 9).reshape(LANES, 3, 3)
    update_kernel.correct(lanes.w, lanes.rec, lanes.out)
    after = lanes.get("rec", 0, 27)
    assert np.array_equal(after[::2], before[::2])
    s = hs @ parts["sigma"] @ np.swapaxes(hs, 1, 2) + np.diag(z[5:8])
    k = parts["sigma"] @ np.swapaxes(hs, 1, 2) @ np.linalg.inv(s)
    mean = np.column_stack([parts["range"], parts["az"], parts["el"]]) + np.einsum("lij,lj->li", k, e)
    rho, ca, sa, ce, se = after[:, MU : MU + 5].T
    got = np.column_stack([rho, np.arctan2(sa, ca), np.arctan2(se, ce)])
    assert np.allclose(got[1::2], mean[1::2], rtol=1e-9, atol=1e-9)
    sigma = parts["sigma"] - k @ hs @ parts["sigma"]
    assert np.allclose(after[1::2, SIGMA : SIGMA + 6], sigma[1::2][:, *np.triu_indices(3)], rtol=1e-7, atol=1e-12)
    gain = parts["gain"] - k @ a
    assert np.allclose(after[1::2, GAIN : GAIN + 9], gain[1::2].reshape(-1, 9), rtol=1e-8, atol=1e-10)


def test_logarithm_is_good_enough_to_choose_by():
    lanes = Lanes()
    values = np.logspace(-30, 12, LANES)
    lanes.set("w", W_DET, values[:, None])
    pair_kernel.logarithm(lanes.w, lanes.w.view(np.int64))
    assert np.allclose(lanes.get("w", W_LOG, 1)[:, 0], np.log(values), atol=1e-6)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("n", [4, 5])
def test_nuisances_follow_the_information_form(n, known):
    """P_new = (P^-1 + I)^-1 and the exact evidence, also where an offset is known (a zero row of P)."""
    rng = np.random.default_rng(6)
    lanes = Lanes(n)
    p_root, i_root = rng.normal(size=(LANES, n, n)), rng.normal(size=(LANES, n, 2))
    if known:
        p_root[:, 1] = 0.0
    p, info = p_root @ np.swapaxes(p_root, 1, 2), i_root @ np.swapaxes(i_root, 1, 2)
    y = rng.normal(size=(LANES, n))
    at = sums_of(n)
    lanes.set("v", at.cov, p.reshape(LANES, -1))
    lanes.set("v", V_Y, y)
    lanes.set("v", at.info, np.tril(info).reshape(LANES, -1))
    nuisance_kernel.condition(lanes.v, n)
    new = np.linalg.solve(np.eye(n) + p @ info, p)
    assert np.allclose(lanes.get("v", at.cov, n * n).reshape(LANES, n, n), new, rtol=1e-9, atol=1e-11)
    assert np.allclose(lanes.get("v", at.change, n), np.einsum("lij,lj->li", new, y), rtol=1e-9, atol=1e-10)
    evidence = 0.5 * np.einsum("li,lij,lj->l", y, new, y) - 0.5 * np.log(np.linalg.det(np.eye(n) + p @ info))
    assert np.allclose(lanes.get("v", V_WEIGHT, 1)[:, 0], evidence, rtol=1e-9)
