"""Command lines run in this process: what a user types, and what comes of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
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


@pytest.fixture
def cellslam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Runs a command line in an empty directory; words may be anything that has a text."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def run(*words: object) -> Done:
        capfd.readouterr()
        try:
            status = main([str(word) for word in words])
        except SystemExit as error:
            status = int(error.code or 0)
        captured = capfd.readouterr()
        return Done(status, captured.out, captured.err)

    return run


def refused(done: Done, *texts: str) -> None:
    """Assert that a command line was refused in one line that has these texts."""
    assert done.status == 2 and done.err.count("\n") == 1 and done.err.startswith("cellslam: "), done.err
    for text in texts:
        assert text in done.err, done.err
