"""What README.md promises: it fits a screen, its commands parse, its links lead somewhere."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from cellslam.cli.main import build_parser

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])  # Sphinx looks after the pages of the site
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    targets = [t.split("#")[0] for t in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in t]
    assert targets or page != "README.md"
    missing = [t for t in targets if t and not ((ROOT / page).parent / t).exists()]
    assert missing == []


def test_the_readme_is_short_and_says_what_a_virtual_transmitter_is():
    assert len(README.split()) <= 600
    assert "*virtual\ntransmitter* (VT)" in README.partition("```")[0]


def test_commands_of_the_readme_parse():
    lines = [line.split() for line in re.findall(r"`(?:\.venv/bin/)?cellslam ([a-z][^`]*)`", README)]
    whole = [words for words in lines if len(words) > 1]
    assert len(whole) >= 1
    for words in whole:
        build_parser(words).parse_args(words)


def test_install_and_test_lines_are_one_line_each_and_ci_runs_the_second():
    run, test = re.findall(r"```sh\n(.*?)\n```", README, re.S)[:2]
    for line in (run, test):
        assert "\n" not in line and line.startswith("python3 -m venv ") and "index" not in line
    assert run.endswith("cellslam run lund-530")
    found = subprocess.run(
        ["grep", "-m", "1", "-F", "pip install '.[test]'", "README.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == test
    assert "pip install '.[test]'" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
