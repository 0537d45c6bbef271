"""Damaged files of every kind are read, or refused in one line: three hundred here, thousands by

python -m tools fuzz --cases 3000
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CASES = 300


@pytest.mark.slow
def test_damaged_files_are_read_or_refused_in_one_line() -> None:
    command = [sys.executable, "-m", "tools", "fuzz", "--cases", str(CASES)]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and f"{CASES} files, 0 failures" in done.stdout, (
        done.stdout[-4000:] + done.stderr[-2000:]
    )
