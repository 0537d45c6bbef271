"""Damaged files of every kind are refused in one line, or read with no value changed unnoticed: some hundreds here,
thousands by

python -m tools fuzz --cases 3000
"""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

CASES = 600
LIMIT_S = 60.0  # of processor time


@pytest.mark.slow
def test_damaged_files_are_read_or_refused_in_one_line() -> None:
    command = [sys.executable, "-m", "tools", "fuzz", "--cases", str(CASES)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and f"{CASES} files, 0 failures" in done.stdout, (
        done.stdout[-4000:] + done.stderr[-2000:]
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < LIMIT_S
