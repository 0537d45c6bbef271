"""What README.md promises: its estimator runs, its commands parse, its links and metric names exist."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.cli.main import build_parser
from cellslam.benchmarks.scores.trial_result import ROW_KEYS
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_estimator_of_the_readme_runs(toy_recording, tmp_path, monkeypatch):
    code = re.search(r"```python\n(.*?)```", README, re.S)
    assert code is not None
    (tmp_path / "coasting.py").write_text(code[1])
    monkeypatch.chdir(tmp_path)
    recording = toy_recording(snapshots=20, seed=1)
    (request,) = resolve({}, ["coasting:Coasting"], {})
    result = estimate(recording, request, np.random.default_rng(0))
    assert result.poses.shape == (20, 6)
    np.testing.assert_array_equal(result.poses[0], recording.start_pose)


def test_every_row_key_is_explained():
    explained = set(re.findall(r"`([a-z_]+)`", README))
    assert set(ROW_KEYS) <= explained


@pytest.mark.parametrize("page", ["README.md", *(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))])
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    targets = [t.split("#")[0] for t in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in t]
    assert targets or page != "README.md"
    missing = [t for t in targets if t and not ((ROOT / page).parent / t).exists()]
    assert missing == []


def test_commands_of_the_readme_parse():
    lines = [line.split() for line in re.findall(r"`(?:\.venv/bin/)?cellslam ([a-z][^`]*)`", README)]
    whole = [words for words in lines if len(words) > 1]
    assert len(whole) >= 5
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
