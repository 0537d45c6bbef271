"""The fixed suites and the benchmarks that are sweeps."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.tasks import plan
from cellslam.benchmarks.tables import suite_rows
from cellslam.benchmarks.tables.suite_tables import suite_markdown
from cellslam.cli.main import main
from cellslam.scenarios import suites
from cellslam.scenarios.loading import load, tables_of
from cellslam.scenarios.suites import SUITES, Suite, digest, points_of, scenario_of, suite, superseded_by
from cellslam.sim.errors import InputError
from tests.command_line import Run, refused
from tests.short_drive import SET

ROOT = Path(__file__).parents[3]
ENTRY, LEADERBOARD = ROOT / "benchmarks" / "results" / "standard-4.json", ROOT / "docs" / "leaderboard.md"
# A suite never changes: what would change its results is another version.
DIGESTS = {
    "standard-2": "f2ad4471781461225a76a2056f28104016ae4d6ee8bc10681ab0d56f517cc10c",
    "standard-3": "1e5126f842e3406016cb461398f11e18081c588914353b1181f3e8e7049c70f8",
    "standard-4": "ccb8e53a47f2cc308d7ecab7f0da00ef92b72035f333bbe55be48ad263c6d1dd",
}


@pytest.mark.parametrize("name", SUITES)
def test_a_suite_never_changes(name: str) -> None:
    one = suite(name)
    assert digest(one) == DIGESTS[name]
    for scenario in one.scenarios:
        assert scenario_of(one, scenario).name == scenario


def test_suites_are_found_by_name_and_one_that_has_a_later_version_says_so() -> None:
    assert suite("standard") is suite("standard-4")
    with pytest.raises(InputError, match=r"unknown suite 'standart'.*standard"):
        suite("standart")
    rows = pd.DataFrame(columns=[*suite_rows.COLUMNS])
    for name, later in (("standard-3", "standard-4"), ("standard-4", None)):
        assert superseded_by(suite(name)) == later
        some = suite_rows.SuiteRows(suite(name), ("canyon",), 1, {}, "x", frozenset(), rows)
        assert ("Superseded by `standard-4`." in suite_markdown(some, "command", "")) == (later is not None)


def test_every_value_of_a_suite_is_written_out() -> None:
    """A default that changes later must not change a suite."""
    one = suite("standard-4")
    for name in one.scenarios:
        written = tables_of(suites.FOLDER / f"{name}.toml")
        for table, values in tomllib.loads(scenario_of(one, name).toml()).items():
            assert not isinstance(values, dict) or values.keys() <= written[table].keys(), (name, table)


@pytest.mark.slow
def test_the_entry_of_the_leaderboard_is_of_the_options_that_estimators_have() -> None:
    """Else `--check` refuses it. A new option that changes no drive of the suite needs new keys, and no new drives."""
    entry = suite_rows.read(ENTRY)
    one = entry.suite
    points = points_of(one, one.scenarios, entry.rows["estimator"].unique().tolist())
    made = plan(points, [one.trials_of(name) for name in one.scenarios], one.seed, trajectories=False)
    assert {job.key for task in made.tasks for job in task.jobs} == set(entry.rows["key"])


@pytest.mark.slow
def test_the_leaderboard_says_what_its_entry_gives(tmp_path: Path) -> None:
    page = tmp_path / "leaderboard.md"
    assert main(["bench", "leaderboard", str(ENTRY), "--write", str(page)]) == 0
    made, kept = (without_numbers(path.read_text()) for path in (page, LEADERBOARD))
    assert made == kept


def without_numbers(text: str) -> list[str]:
    """Return the tables of a page, whose last digits another processor may round otherwise."""
    return [re.sub(r"[\d.]+(e-\d+)?", "", line) for line in text.splitlines() if line.startswith("|")]


def test_accuracy_writes_its_tables_and_resumes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The suite's drives take seconds: a short one under the name of one of them.
    monkeypatch.setattr(suites, "scenario_of", lambda _, name: load("tiny", {**SET, "name": name}))
    page = tmp_path / "results.md"
    line = ["bench", "accuracy", "--trials", "1", "--scenario", "canyon", "--estimator", "dead-reckoning"]
    line += ["--executor", "serial", "--out", str(tmp_path / "out"), "--write", str(page)]
    assert main([*line, "--quiet"]) == 0
    text = page.read_text()
    assert capfd.readouterr().out == text
    assert "standard-4, a part: trials 0 to 0 of canyon" in text and "Not the suite's result" in text
    frame = results(tmp_path / "out")
    assert (frame["seed"].tolist(), frame["scenario"].tolist()) == ([530], ["canyon"])
    cells = next(row for row in text.splitlines() if row.startswith("| dead-reckoning")).split("|")
    assert cells[2].split()[0] == f"{frame['position_rmse_m'][0]:.2f}" and cells[-2].strip() == "1/1"
    assert main(line) == 0
    assert "1 of them finished already" in capfd.readouterr().err


@pytest.mark.slow
def test_changed_options_are_another_row_and_not_the_result_of_the_suite(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SUITES, "standard-4", Suite("standard-4", ("canyon",), 530, 1))
    monkeypatch.setattr(suites, "scenario_of", lambda _, name: load("tiny", {**SET, "name": name}))
    line = ["bench", "accuracy", "--estimator", "ekf-slam", "--executor", "serial", "--quiet"]
    line += ["--out", str(tmp_path / "out")]
    assert main(line) == 0
    own = capfd.readouterr().out
    assert "Not the suite's result" not in own
    assert main([*line, "--set", "estimator.ekf-slam.gate=1.0"]) == 0
    text = " ".join(capfd.readouterr().out.split())
    assert "standard-4, with estimator.ekf-slam.gate=1.0" in text
    assert "Not the suite's result: it takes the options that estimators have themselves." in text
    assert len(results(tmp_path / "out")) == 2  # beside the suite's own row, not in its place
    assert main(line) == 0
    assert capfd.readouterr().out == own


@pytest.fixture
def entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The rows of two estimators in a suite of six trials, of one scenario but one: short drives under known names."""
    few = Suite("standard-4", ("full", "canyon", "anywhere"), 530, 6, {"anywhere": 1})
    monkeypatch.setitem(SUITES, "standard-4", few)
    monkeypatch.setattr(suites, "scenario_of", lambda _, name: load("tiny", {**SET, "name": name}))
    line = ["bench", "accuracy", "--estimator", "dead-reckoning", "--estimator", "ekf-slam", "--executor", "serial"]
    files = {"--out": "out", "--write": "page.md", "--rows": "rows.json"}
    words = [word for option, name in files.items() for word in (option, str(tmp_path / name))]
    assert main([*line, *words, "--quiet"]) == 0
    return tmp_path / "rows.json"


@pytest.mark.slow
def test_an_entry_is_ranked_and_holds_when_it_is_driven_again(entry: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = " ".join(entry.with_name("page.md").read_text().split())
    assert said.index("## All scenarios") < said.index("## full") < said.index("## canyon")
    assert "trials 0 to 5 of each scenario, 0 to 0 of `anywhere`." in said
    assert said.count("Critical difference of mean ranks: 0.80") == 3 and "of 1 pairs" in said
    assert "![Mean ranks](page.png)" in said and entry.with_name("page.png").stat().st_size > 3000
    some = suite_rows.read(entry)
    assert some.whole and len(some.rows) == 26
    capfd.readouterr()
    assert main(["bench", "accuracy", "--check", str(entry), "--sample", "2", "--executor", "serial"]) == 0
    assert "4 of 4 drives are as the entry says" in capfd.readouterr().out

    page = entry.with_name("board.md")
    assert main(["bench", "leaderboard", str(entry), "--write", str(page)]) == 0
    board = page.read_text()
    ranked = [line.split("|")[1].strip() for line in board.splitlines() if line.startswith(("| ekf", "| dead"))]
    assert "How estimators compare on `standard-4`: 6 drives of each of `full`, " in board
    assert sorted(ranked[:2]) == sorted(some.rows["estimator"].unique()) and ranked[:2] == ranked[2:]
    assert "![Mean ranks and critical differences](board.png)" in board


@pytest.mark.slow
def test_an_entry_that_is_not_what_its_estimator_does_is_found_out(
    entry: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = entry.read_text()
    false = json.loads(text)
    at = {name: index for index, name in enumerate(false["columns"])}
    for row in false["rows"]:
        row[at["position_rmse_m"]] *= 0.95 if row[at["estimator"]] == "ekf-slam" else 1.001
    entry.write_text(json.dumps(false))
    capfd.readouterr()
    check = ["bench", "accuracy", "--check", str(entry), "--executor", "serial"]
    assert main([*check, "--sample", "1"]) == 1
    out = capfd.readouterr().out
    assert "1 of 2 drives are as the entry says" in out
    assert any("ekf-slam" in line and "position_rmse_m" in line for line in out.splitlines())

    board = ["bench", "leaderboard", str(entry), str(entry), "--write", str(entry.with_name("board.md"))]
    fewer = json.dumps({**false, "rows": false["rows"][1:]})
    for content, words, expected in (
        (text, board, "is in another file too"),
        (text.replace('"digest": "', '"digest": "0'), board, "made with another standard-4"),
        (fewer, board, "not every drive of standard-4 once for each estimator"),
        ("{}", check, "not rows of a suite"),
        (text, [*check, "--sample", "14"], "--sample 14: must be 1 to 13"),
    ):
        entry.write_text(content)
        assert main(words) == 2
        err = capfd.readouterr().err
        assert err.count("\n") == 1 and expected in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--suite", "nothing"), "unknown suite 'nothing'"),
        (("--trials", "21"), "--trials 21: must be 1 to 20"),
        (("--scenario", "tiny"), "unknown scenario of standard-4 'tiny'"),
        (("--write", "/nowhere/x.md"), "there is no folder"),
        (("--trials", "2", "--rows", "x.json"), "--rows is of a whole suite"),
        (("--check", "/nowhere/x.json"), "cannot be read"),
        (("--set", "radio.load=0.5"), "radio.load: the worlds of a suite are fixed"),
        (("--set", "estimator.fastslam.lagg=0"), "estimator.fastslam.lagg"),
        (("--estimator", "ekf-slam", "--set", "estimator.fastslam.lag=0"), "not run here (run: ekf-slam)"),
        (("--set", "estimator.fastslam.lag=0", "--rows", "x.json"), "leave out --set"),
        (("--set", "estimator.fastslam.lag=0", "--check", "x.json"), "leave out --set"),
    ],
)
def test_wrong_requests_are_one_line(words: tuple[str, ...], expected: str, tmp_path: Path, cellslam: Run) -> None:
    refused(cellslam("bench", "accuracy", "--out", "out", *words), expected)
    assert not list(tmp_path.iterdir())
