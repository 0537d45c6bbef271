"""What the Tab key offers, `NO_COLOR`, and `--verbose`."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from cellslam.cli.main import main


def offered(line: str) -> set[str]:
    """Return what argcomplete answers a shell through file descriptor 8."""
    environment = {
        **os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_SHELL": "bash",
        "COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9",
    }  # fmt: skip
    command = f"'{sys.executable}' -m cellslam 8>&1 9>&2 >/dev/null"
    ran = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True)
    return {word.strip() for word in ran.stdout.split("\n") if word.strip()}


@pytest.mark.slow
def test_commands_options_scenarios_and_estimators_are_completed() -> None:
    assert offered("cellslam re") == {"reproduce", "report", "record", "replay"}
    assert offered("cellslam run tin") == {"tiny"}
    assert offered("cellslam run tiny --estimator ek") == {"ekf-slam"}
    assert offered("cellslam run tiny --tri") == {"--trials"}


def test_verbose_adds_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "nowhere"]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["show", "nowhere", "--verbose"]) == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.slow
def test_no_colour_in_pipes_nor_where_none_is_wanted() -> None:
    wanted = {**os.environ, "FORCE_COLOR": "1", "NO_COLOR": "1", "TERM": "xterm"}
    for environment in (dict(os.environ), wanted):
        ran = subprocess.run(
            [sys.executable, "-m", "cellslam", "list", "scenarios"], env=environment, capture_output=True, check=True
        )
        assert b"\x1b[3" not in ran.stdout and b"\x1b[9" not in ran.stdout
