"""Compile the kernels by a made-up drive of a few snapshots, so that compiling is not timed with an estimate."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam import attitude, misfit
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.fastslam.choice import Choice
from cellslam.slam.fastslam.layout import LANES
from cellslam.slam.fastslam.options import FastSlamOptions
from cellslam.slam.fastslam.particles import draw, select


def warm_up(options: FastSlamOptions, choice: Choice) -> None:
    """Run four snapshots with eight particles; every kernel of the filter is compiled, or loaded from its cache."""
    from cellslam.slam.fastslam.filter import FastSlam

    small = options.model_copy(
        update={
            "particles": 8,
            "particles_start": 12,
            "start_phase_s": 0.2,
            "effective_share": 1.0,
            "vts_per_link": 4,
        }
    )
    sheet = OdometryModel(np.full(6, 0.01), np.full(6, 0.01), np.full(6, 0.001), np.full(6, 0.01))
    links = Links(np.array([0, 1]), np.array([1, 2]), np.array([0, 0]))
    sites = Sites(("A", "B"), np.zeros(2), np.array([150.0, 150.0]))
    rng = np.random.default_rng(0)
    estimator = FastSlam(small)
    estimator.choice = choice
    setup = Setup(links, sites, sheet, np.zeros(6), np.zeros(6))
    estimator.start(setup, rng)
    for t in range(4):
        columns = [
            np.array(c, float) for c in ([600.0, 605.0, 700.0], [0.1, 1.2, 0.5], [0.1, 0.0, 0.1], [10.0, 10.0, 10.0])
        ]
        link = np.array([0, 0, 1])
        link.setflags(write=False)  # as in a drive: compiled code is typed by that
        snapshot = Snapshot(t, np.arange(3), link, *columns)
        estimator.step(0.0 if t == 0 else 0.1, np.array([1.0, 0, 0, 0, 0, 0]), snapshot)
    attitude.warm_up()
    misfit.warm_up()
    for blocks, ancestor in ((1, 0), (2, 40)):
        two = draw(setup, blocks * LANES, 20.0, 4, rng, record=choice.record)
        select(two, np.full(len(two), ancestor))
