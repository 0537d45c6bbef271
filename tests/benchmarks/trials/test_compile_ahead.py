"""Kernels compiled in a process of their own while the world is made."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cellslam.benchmarks.trials import compile_ahead as ahead
from cellslam.scenarios.estimator_options import Request
from cellslam.slam.joint.ekf_slam import EkfSlam

SLOW = """
import pathlib, time
class Slow:
    @staticmethod
    def compiled():
        return pathlib.Path("compiled").exists()
    def warm_up(self):
        time.sleep(0.5)
        pathlib.Path("compiled").touch()
"""


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Request:
    (tmp_path / "slow_to_compile.py").write_text(SLOW)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    import slow_to_compile

    monkeypatch.delitem(sys.modules, "slow_to_compile")
    return Request("slow", slow_to_compile.Slow, None)


def test_what_is_not_compiled_is_compiled_elsewhere(slow: Request) -> None:
    ahead.begin([Request("plain", object, None), slow])
    assert not Path("compiled").exists()
    ahead.finish(slow.estimator)
    assert Path("compiled").exists() and slow.estimator.compiled()
    ahead.begin([slow])
    assert not ahead._running
    ahead.finish(slow.estimator)


def test_a_failure_there_is_no_failure_here(slow: Request) -> None:
    Path("slow_to_compile.py").write_text("raise RuntimeError")
    ahead.begin([slow])
    ahead.finish(slow.estimator)
    assert not Path("compiled").exists() and not ahead._running


def test_ekf_slam_knows_whether_it_is_compiled() -> None:
    EkfSlam().warm_up()
    assert EkfSlam.compiled()
