"""Kernels compiled in a process of their own while the world is made."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from cellslam.benchmarks.trials import estimation
from cellslam.scenarios.estimator_options import Request
from cellslam.slam.joint.ekf_slam import EkfSlam

SLOW = """
import os, pathlib, time
class Slow:
    def __init__(self, options=None): pass
    @staticmethod
    def compiled():
        return pathlib.Path("compiled").exists()
    def warm_up(self):
        if not self.compiled():
            time.sleep(0.5)
            pathlib.Path("compiled").write_text(str(os.getpid()))
"""


@pytest.mark.parametrize("broken", [False, True])
def test_what_is_not_compiled_is_compiled_elsewhere_or_else_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: bool
) -> None:
    file = tmp_path / "slow_to_compile.py"
    file.write_text(SLOW)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    import slow_to_compile

    del sys.modules["slow_to_compile"]
    slow = Request("slow", slow_to_compile.Slow, None)
    if broken:
        file.write_text("raise RuntimeError")
    estimation.compile_ahead([Request("plain", object, None), slow])
    assert not Path("compiled").exists()
    estimation.warm_up(slow)
    assert (Path("compiled").read_text() == str(os.getpid())) == broken
    estimation.compile_ahead([slow])
    assert not estimation._compiling


def test_ekf_slam_knows_whether_it_is_compiled() -> None:
    EkfSlam().warm_up()
    assert EkfSlam.compiled()
