"""What the command line says of itself: every example parses, what is mistyped is named with what is like it."""

from __future__ import annotations

import shlex

import pytest

from cellslam.cli.main import SECTIONS, build_parser, main, module_of

ALL = {name: summary for section in SECTIONS.values() for name, summary in section.items()}


@pytest.mark.parametrize("name", ALL)
def test_examples_of_a_command_are_of_it_and_parse(name: str) -> None:
    assert module_of(name).EXAMPLES
    for line in module_of(name).EXAMPLES:
        assert line.startswith(name)
        words = shlex.split(line)
        arguments = build_parser(words).parse_args(words)
        assert arguments.command.__module__ == module_of(name).__name__


def test_help_names_every_command_and_fits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = capsys.readouterr().out
    for name, summary in ALL.items():
        assert f"  {name:18}{summary}" in said
    assert max(map(len, said.splitlines())) <= 100


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--verison", "unknown argument '--verison'; did you mean '--version'?"),
        ("run tiny --trails 3", "unknown argument '--trails'; did you mean '--trials'?"),
        ("run tiny lund-530", "unknown argument 'lund-530'"),
        ("bench acuracy", "did you mean 'accuracy'?"),
    ],
)
def test_what_is_mistyped_is_named(line: str, named: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(line.split())
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert named in said and said.count("\n") == 1


def test_show_keeps_the_keys_that_were_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "tiny", "gyro", "bias"]) == 0
    said = capsys.readouterr().out
    assert "odometry.gyro_bias_deg_per_s" in said and "gyro_noise" not in said
    assert main(["show", "tiny", "phlogiston"]) == 2
    assert "no key of tiny has phlogiston" in capsys.readouterr().err


def test_list_without_a_kind_lists_both_within_100_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    said = capsys.readouterr().out
    assert "lund-530" in said and "ekf-slam" in said
    assert max(map(len, said.splitlines())) <= 100


def test_doctor_says_what_is_installed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for word in ("cellslam  ", "python  ", "cores", "numba ", "extra gtsam", "extra report"):
        assert word in said
    assert max(map(len, said.splitlines())) <= 100
