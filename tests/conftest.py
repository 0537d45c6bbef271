from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Links, Measurements, OdometryModel, Recording, Sites, Truth, VirtualTransmitters
from cellslam.sim.world import simulate
from cellslam.slam.model.measurement_model import predict

sys.path.append(str(Path(__file__).parents[1]))  # for `tools`; what is installed goes before
from tests.command_line import Done, Run, command_line


def make_toy_recording(snapshots: int = 40, seed: int = 0, truth: bool = True) -> Recording:
    """Two sites with two links each and one VT a link, seen from a curve at 1 m/s; no ray tracing."""
    rng = np.random.default_rng(seed)
    time_s = 0.1 * np.arange(snapshots)
    speed = np.tile([1.0, 0.0, 0.0, 0.2, 0.0, 0.0], (snapshots, 1))
    speed[0] = 0.0
    poses = np.zeros((snapshots, 6))
    poses[0] = [3.0, -2.0, 1.5, 0.4, 0.01, -0.02]
    for t in range(1, snapshots):
        poses[t] = integrate_pose(poses[t - 1], speed[t], 0.1)
    vts = np.array([[80.0, 10.0, 30.0], [-60.0, 50.0, 25.0], [20.0, -90.0, 28.0], [-70.0, -40.0, 22.0]])
    site_of_link, offsets = np.array([0, 0, 1, 1]), rng.normal(0.0, 100.0, 2)
    seen = np.stack(np.meshgrid(np.arange(snapshots), np.arange(4), indexing="ij"), -1).reshape(-1, 2)
    seen = seen[rng.random(len(seen)) < 0.8]
    std = np.array([0.5, 0.02, 0.02])
    exact = predict(poses[seen[:, 0]], vts[seen[:, 1]])
    z = exact + std * rng.normal(size=exact.shape)
    z[:, 0] += offsets[site_of_link[seen[:, 1]]]
    z[:, 1] = np.arctan2(np.sin(z[:, 1]), np.cos(z[:, 1]))
    model = OdometryModel(*(np.array(c) for c in ([0.05] * 6, [0.0] * 6, [0.0] * 6, [0.01] * 6)))
    hidden = Truth(
        poses,
        seen[:, 1].astype(np.int64),
        np.tile(std, (len(seen), 1)),
        VirtualTransmitters(
            vts,
            site_of_link,
            np.array([0, 1, 0, 1]),
            np.array([[-1, -1], [3, -1], [-1, -1], [5, -1]]),
            np.array([[v, 0, snapshots - 1] for v in range(4)]),
        ),
        vts[[0, 2]],
        offsets,
        np.zeros((snapshots, 6)),
        np.zeros(6),
    )
    odometry = speed + 0.05 * np.sqrt(10.0) * rng.normal(size=speed.shape)
    odometry[0] = 0.0
    return Recording(
        time_s,
        odometry,
        model,
        Links(site_of_link, np.array([375, 376, 177, 178]), np.zeros(4, np.int64)),
        Sites(("A", "B"), np.zeros(2), np.full(2, 150.0)),
        Measurements(seen[:, 0], seen[:, 1], z[:, 0], z[:, 1], z[:, 2], np.full(len(seen), 20.0)),
        poses[0],
        np.full(6, 1e-3),
        {"scenario": {"name": "toy"}, "seed": seed, "trial": 0},
        hidden if truth else None,
    )


@pytest.fixture
def toy_recording() -> Callable[..., Recording]:
    return make_toy_recording


@pytest.fixture(scope="session")
def tiny() -> Recording:
    """A drive of the preset `tiny` as it is; worlds that differ in one key are compared with it."""
    return simulate(load("tiny").world, 3, 0)


@pytest.fixture
def cellslam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Runs a command line in this process, in an empty directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def run(*words: object) -> Done:
        return command_line(words, capfd)

    return run


WORLD = "from cellslam.benchmarks.bound.cramer_rao import bound; import cellslam; bound(cellslam.simulate('tiny'))"
FILTER = (
    "from cellslam.slam.registry import options_model, resolve; "
    "resolve({0!r})(options_model(resolve({0!r}))({1})).warm_up()"
)
# What two processes compile, about as long each.
PARTS = (
    (FILTER.format("ekf-slam", ""), FILTER.format("paper-fastslam", "")),
    (WORLD, FILTER.format("fastslam", ""), FILTER.format("phd-slam", "")),
)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile worlds and filters once, in two processes, before the workers of a whole suite all begin to; a worker has
    one thread, as those of a sweep have: of BLAS, too, whose threads wait for one another more than they work."""
    config = session.config
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the workers' libraries read it when they are imported
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or a hundred processes compile the same modules
    if hasattr(config, "workerinput"):
        numba.set_num_threads(1)
    if hasattr(config, "workerinput") or config.args_source is not config.ArgsSource.TESTPATHS:
        return
    started = [subprocess.Popen([sys.executable, "-P", "-c", "\n".join(part)]) for part in PARTS]
    for process in started:
        assert process.wait() == 0
