"""Small synthetic drives for the tests of scores, bound and figures: geometry by hand, no ray tracing."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.sweeps import tasks
from cellslam.sim import recording as contract
from cellslam.sim.frames import integrate_pose, mean_velocity, wrap_angle
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.model.measurement_model import predict
from tests.benchmarks.trials.hostile_estimators import MISFITS

MakeRecording = Callable[..., Recording]


def curved_drive(snapshots: int, dt_s: float) -> Floats:
    """Poses (T, 6) at 1.2 m/s on a curve that turns both ways."""
    pose, poses = np.array([10.0, -20.0, 1.8, 0.3, 0.0, 0.0]), []
    for t in range(snapshots):
        poses.append(pose)
        pose = integrate_pose(pose, [1.2, 0, 0, 0.05 * np.sin(0.03 * t), 0, 0], dt_s)
    return np.array(poses)


def scatter(
    vts_per_site: int, sites: int, rng: np.random.Generator
) -> tuple[Floats, contract.VirtualTransmitters, int]:
    """Sites, and VTs around them, the first of each at the site itself."""
    position = rng.uniform([-300, -300, 30], [300, 300, 45], (sites, 3))
    around = rng.normal(0, [150, 150, 5], (sites, vts_per_site, 3))
    around[:, 0] = 0
    count = sites * vts_per_site
    order = (np.arange(count) % vts_per_site > 0).astype(np.int64)
    facets, none = np.full((count, 2), -1, np.int64), np.zeros((0, 3), np.int64)
    of_site = np.repeat(np.arange(sites), vts_per_site)
    vts = contract.VirtualTransmitters((position[:, None] + around).reshape(-1, 3), of_site, order, facets, none)
    return position, vts, count


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, in which there is a module `misfits`: the hostile estimators."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "misfits", raising=False)
    tasks._request_of.cache_clear()
    (tmp_path / "misfits.py").write_text(MISFITS, "utf-8")
    return tmp_path


@pytest.fixture
def make_recording() -> MakeRecording:
    """A factory of synthetic recordings: `make_recording(seed=..., snapshots=..., ...)`."""

    def make(
        seed: int = 1,
        snapshots: int = 200,
        sites: int = 2,
        ports: int = 2,
        vts_per_site: int = 4,
        detection: float = 0.7,
        clutter: float = 0.2,
        std: tuple[float, float, float] = (0.6, np.radians(1.0), np.radians(1.5)),
        offset_std_m: float = 150.0,
        dt_s: float = 0.075,
        noise_density: tuple[float, ...] = (0.02, 0, 0, 0.001, 0, 0),
        bias: tuple[float, ...] = (0, 0, 0, 0.001, 0, 0),
        bias_walk_density: tuple[float, ...] = (0, 0, 0, 1e-5, 0, 0),
        scale: tuple[float, ...] = (0.02, 0, 0, 0, 0, 0),
        start_std: tuple[float, ...] = (0.1, 0.1, 0, 0.01, 0, 0),
    ) -> Recording:
        rng = np.random.default_rng(seed)
        poses = curved_drive(snapshots, dt_s)
        position, vts, count = scatter(vts_per_site, sites, rng)
        offsets = rng.normal(0, 1, sites) * offset_std_m
        each = (noise_density, bias, bias_walk_density, scale)
        model = contract.OdometryModel(*(np.array(values, np.float64) for values in each))
        first = rng.normal(0, 1, 6) * model.bias
        walk = rng.normal(0, 1, (snapshots - 1, 6)) * model.bias_walk_density * dt_s**0.5
        drawn_bias = np.cumsum(np.vstack([first, walk]), 0)
        drawn_scale = rng.normal(0, 1, 6) * model.scale
        u = np.zeros((snapshots, 6))
        u[1:] = mean_velocity(poses[:-1], poses[1:], np.full(snapshots - 1, dt_s))
        noise = rng.normal(0, 1, (snapshots - 1, 6)) * model.noise_density / dt_s**0.5
        u[1:] = u[1:] * (1 + drawn_scale) + drawn_bias[1:] + noise
        of_site = np.repeat(np.arange(sites), ports)
        links = contract.Links(of_site, 100 + of_site, np.tile(np.arange(ports), sites))
        rows, values = [], []
        begin = rng.integers(0, snapshots // 2 + 1, count)
        length = rng.integers(snapshots // 4, snapshots + 1, count)
        for t in range(snapshots):
            for link in range(len(links)):
                for v in np.flatnonzero((vts.site == links.site[link]) & (begin <= t) & (t < begin + length)):
                    if rng.random() < detection:
                        z = predict(poses[t], vts.position_m[v]) + rng.normal(0, 1, 3) * std
                        z[0] += offsets[links.site[link]]
                        rows.append((t, link, v))
                        values.append(z)
                for _ in range(rng.poisson(clutter)):
                    rows.append((t, link, -1))
                    values.append(rng.uniform([50, -np.pi, -0.2], [700, np.pi, 0.5]))
        r, z = np.array(rows, np.int64).reshape(-1, 3), np.array(values).reshape(-1, 3)
        z[:, 1] = wrap_angle(z[:, 1])
        z[:, 2] = np.clip(z[:, 2], -np.pi / 2, np.pi / 2)
        true_std = np.where(r[:, 2:] >= 0, np.array(std), np.nan)
        sigma = np.array(start_std)
        snr_db, names = np.full(len(r), 10.0), tuple("ABCDEF"[:sites])
        return Recording(
            time_s=np.arange(snapshots) * dt_s, odometry=u, odometry_model=model, links=links,
            sites=contract.Sites(names, np.zeros(sites), np.full(sites, offset_std_m)),
            measurements=contract.Measurements(r[:, 0], r[:, 1], z[:, 0], z[:, 1], z[:, 2], snr_db),
            start_pose=poses[0] + rng.normal(0, 1, 6) * sigma, start_std=sigma,
            truth=contract.Truth(poses, r[:, 2], true_std, vts, position, offsets, drawn_bias, drawn_scale),
        )  # fmt: skip

    return make
