"""Command lines run in this process: what a user types, and what comes of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from cellslam.cli.main import main


@dataclass
class Done:
    status: int
    out: str
    err: str

    @property
    def rows(self) -> list[dict[str, Any]]:
        """What --json printed."""
        assert self.status == 0 or self.out, self.err
        return json.loads(self.out)


Run = Callable[..., Done]
# A module of estimators of one's own.
PLUGIN = """
import numpy as np
from cellslam.sim.frames import integrate_pose
from cellslam.slam.api import Estimate

class Mine:
    name = "mine"
    requires_truth = False
    def __init__(self, options): pass
    def start(self, setup, rng): self.pose = setup.start_pose
    def step(self, dt_s, odometry, snapshot):
        self.pose = integrate_pose(self.pose, odometry, dt_s)
        return Estimate(self.pose, np.eye(6))

class Oracle(Mine):
    requires_truth = True
"""


def command_line(words: tuple[object, ...], capfd: pytest.CaptureFixture[str]) -> Done:
    """Run a command line; words may be anything that has a text."""
    capfd.readouterr()
    try:
        status = main([str(word) for word in words])
    except SystemExit as error:
        status = int(error.code or 0)
    captured = capfd.readouterr()
    return Done(status, captured.out, captured.err)


def refused(done: Done, *texts: str) -> None:
    """Assert that a command line was refused in one line that has these texts."""
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1) and done.err.startswith("cellslam: "), done.err
    for text in texts:
        assert text in done.err, done.err
