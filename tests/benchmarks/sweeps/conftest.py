from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cellslam.benchmarks.sweeps import tasks
from tests.benchmarks.sweeps.short_sweeps import PLUGIN


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "misfits", raising=False)
    tasks.request_of.cache_clear()
    (tmp_path / "misfits.py").write_text(PLUGIN)
    return tmp_path
