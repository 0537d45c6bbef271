"""What the command line says of itself: help, examples, names that are mistyped, what the Tab key offers."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from cellslam.cli.main import SECTIONS, build_parser, module_of
from tests.command_line import Run, refused

ALL = {name: summary for section in SECTIONS.values() for name, summary in section.items()}
COMMAND = Path(sys.executable).parent / "cellslam"


@pytest.mark.parametrize("name", ALL)
def test_examples_of_a_command_are_of_it_and_parse(name: str) -> None:
    assert module_of(name).EXAMPLES
    for line in module_of(name).EXAMPLES:
        assert line.startswith(name)
        words = shlex.split(line)
        arguments = build_parser(words).parse_args(words)
        assert arguments.command.__module__ == module_of(name).__name__


def test_help_names_every_command_and_fits(cellslam: Run) -> None:
    text = cellslam().out
    for name, summary in ALL.items():
        assert f"  {name:18}{summary}" in text
    assert re.fullmatch(r"cellslam \d+\.\d+\.\d+\n", cellslam("--version").out)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--verison", "unknown argument '--verison'; did you mean '--version'?"),
        ("run tiny --trails 3", "unknown argument '--trails'; did you mean '--trials'?"),
        ("rnu tiny", "unknown command 'rnu'; did you mean 'run'"),
        ("list cities", "unknown value 'cities'"),
    ],
)
def test_what_is_mistyped_is_named(line: str, named: str, cellslam: Run) -> None:
    refused(cellslam(*line.split()), named)


def test_verbose_stands_before_a_command_or_after_it(cellslam: Run) -> None:
    for words in (("--verbose", "show", "tinny"), ("show", "tinny", "--verbose")):
        assert "Traceback" in cellslam(*words).err


def test_show_keeps_the_keys_that_were_asked_for(cellslam: Run) -> None:
    shown = cellslam("show", "tiny", "--set", "radio.load=0.125").out
    assert re.search(r"radio\.load +0\.125 +0 to 1 +share of other cells", shown)
    assert re.search(r"vehicle\.duration_s +[\d.]+ +s +above 0", shown)
    assert "radio.clutter_scale " not in shown and re.search(r"at their defaults: .*radio \(\d+\)", shown)
    assert "radio.clutter_scale " in cellslam("show", "tiny", "--all").out
    some = cellslam("show", "tiny", "gyro", "bias").out
    assert "odometry.gyro_bias_deg_per_s" in some and "gyro_noise" not in some
    assert "no key of tiny has phlogiston" in cellslam("show", "tiny", "phlogiston").err


def test_what_lists_fits_100_columns(cellslam: Run) -> None:
    for command, words in (("list", ("lund-530", "ekf-slam")), ("doctor", ("cores", "numba ", "extra gtsam"))):
        text = cellslam(command).out
        assert all(word in text for word in words)
        assert max(map(len, text.splitlines())) <= 100


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


@pytest.mark.slow
def test_no_colour_in_pipes_nor_where_none_is_wanted() -> None:
    wanted = {**os.environ, "FORCE_COLOR": "1", "NO_COLOR": "1", "TERM": "xterm"}
    words = [sys.executable, "-m", "cellslam", "list", "scenarios"]
    for environment in (dict(os.environ), wanted):
        ran = subprocess.run(words, env=environment, capture_output=True, check=True)
        assert b"\x1b[3" not in ran.stdout and b"\x1b[9" not in ran.stdout
