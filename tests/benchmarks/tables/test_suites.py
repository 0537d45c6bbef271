"""The fixed suites and the benchmarks that are sweeps."""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.cli.bench import accuracy as cli_suite
from cellslam.benchmarks.cli.bench.accuracy import built_in
from cellslam.benchmarks.cli.main import main
from cellslam.benchmarks.sweeps.rows import results
from cellslam.scenarios import load
from cellslam.scenarios.suites import SUITES, scenario_of, suite
from cellslam.sim.errors import InputError

SHORT = {"vehicle.distance_m": 5, "vehicle.duration_s": 7.5, "vehicle.stops": 0, "vehicle.stand_first_s": 0}
# A suite never changes: what would change its results is another version.
DIGESTS = {
    "standard-1": "63174b9494a6a595f55388b580d51296aa33bc002a1534cc3c206bfb19c46270",
}


@pytest.mark.parametrize("name", SUITES)
def test_a_suite_never_changes(name: str) -> None:
    one = suite(name)
    folder = files("cellslam.scenarios.suites") / name
    texts = {scenario: (folder / f"{scenario}.toml").read_text("utf-8") for scenario in one.scenarios}
    said = json.dumps([one.name, one.scenarios, one.seed, one.trials, texts])
    assert hashlib.sha256(said.encode()).hexdigest() == DIGESTS[name]
    for scenario in one.scenarios:
        assert scenario_of(one, scenario).name == scenario


def test_suites_are_found_by_name() -> None:
    assert suite("standard") is suite("standard-1")
    with pytest.raises(InputError, match=r"unknown suite 'standart'.*standard"):
        suite("standart")
    assert {"fastslam", "dead-reckoning", "ekf-slam", "oracle-map"} <= set(built_in())


def test_accuracy_writes_its_tables_and_resumes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The suite's drives take seconds: a short one under the name of one of them.
    monkeypatch.setattr(cli_suite, "scenario_of", lambda _, name: load("tiny", {**SHORT, "name": name}))
    page = tmp_path / "results.md"
    line = ["bench", "accuracy", "--trials", "1", "--scenario", "canyon", "--estimator", "dead-reckoning"]
    line += ["--executor", "serial", "--out", str(tmp_path / "out"), "--write", str(page)]
    assert main([*line, "--quiet"]) == 0
    text = page.read_text()
    assert capfd.readouterr().out == text
    assert "standard-1, a part: trials 0 to 0 of canyon" in text and "Not the suite's result" in text
    frame = results(tmp_path / "out")
    assert (frame["seed"].tolist(), frame["scenario"].tolist()) == ([530], ["canyon"])
    cells = next(row for row in text.splitlines() if row.startswith("| dead-reckoning")).split("|")
    assert cells[2].split()[0] == f"{frame['position_rmse_m'][0]:.2f}" and cells[-2].strip() == "1/1"
    assert "cellslam bench accuracy --trials 1" in text and "numpy " + np.__version__ in text
    assert main(line) == 0
    assert (
        "1 rows are in" in (err := capfd.readouterr().err) and "1 of them finished already" in err and "new" not in err
    )


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--suite", "nothing"), "unknown suite 'nothing'"),
        (("--trials", "21"), "--trials 21: standard-1 has 1 to 20"),
        (("--scenario", "tiny"), "unknown scenario of standard-1 'tiny'"),
        (("--write", "/nowhere/x.md"), "there is no folder"),
    ],
)
def test_wrong_requests_are_one_line(
    words: tuple[str, ...], expected: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "accuracy", "--out", str(tmp_path / "out"), *words]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and expected in err
    assert not list(tmp_path.iterdir())


def test_monte_carlo_measures_rates_overhead_and_table(capfd: pytest.CaptureFixture[str]) -> None:
    short = [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]
    line = ["bench", "monte-carlo", "tiny", *short, "--estimator", "dead-reckoning"]
    assert main([*line, "--trials", "2", "--jobs", "1", "--rows", "400", "--json"]) == 0
    out, err = capfd.readouterr()
    found = json.loads(out)
    assert err == "" and set(found["seconds_by_part"]) == {"world", "dead-reckoning"}
    assert found["ratio"] == pytest.approx(found["serial_seconds"] / found["processes_seconds"], abs=1e-2)
    assert found["table_rows"] == 400 and found["table_cpu_seconds"] > 0
    # What a sweep adds is part of the whole, and not nothing.
    assert 0 < found["overhead_ms_per_trial"] < 1e3 * found["serial_seconds"] / 2
    assert main([*line, "--rows", "3"]) == 2 and "--rows 3: must be at least 20" in capfd.readouterr().err
