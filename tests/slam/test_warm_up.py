"""After `warm_up` a drive compiles nothing: what it took to compile would be in the estimator's time."""

from __future__ import annotations

import subprocess
import sys

import pytest

DRIVE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from cellslam.slam.api import odometry_of, setup_of, snapshots_of
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.registry import options_model, resolve

def compiled():
    rooms = [vars(module) for name, module in sys.modules.items() if name.startswith("cellslam.")]
    found = (value for room in rooms for value in room.values() if isinstance(value, Dispatcher))
    return {kernel.py_func.__qualname__: len(kernel.signatures) for kernel in found}

kind = resolve(sys.argv[1])
model = options_model(kind)
kind(model()).warm_up()
before, drive, estimator = compiled(), tiny_drive(), kind(model())
estimator.start(setup_of(drive), np.random.default_rng(0))
for dt, odometry, snapshot in zip([0.0, *np.diff(drive.time_s[:80])], odometry_of(drive), snapshots_of(drive)):
    estimator.step(float(dt), odometry, snapshot)
assert before
print([name for name, count in compiled().items() if count != before.get(name, 0)])
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf-slam", "bp-slam", "fastslam", "paper-fastslam", "phd-slam"])
def test_nothing_is_left_to_compile(name: str) -> None:
    done = subprocess.run([sys.executable, "-P", "-c", DRIVE, name], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr
