"""Whatever a stranger's estimator does costs its own row: one line says what, the others' rows are as without it."""

from __future__ import annotations

import json
import sqlite3
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import psutil
import pytest

from cellslam.benchmarks import run as run_trials
from cellslam.benchmarks.scores.metrics import COST_KEYS
from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.store import DATABASE
from cellslam.benchmarks.trials import external_processes
from cellslam.benchmarks.trials.answers import decoded
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.trials import score_recording
from cellslam.cli.main import main
from cellslam.scenarios.estimator_options import Request, external_request
from cellslam.scenarios.external_options import requests
from cellslam.sim.recording import Recording
from cellslam.sim.supervisor import MOST_PRINTED
from cellslam.slam.registry import BrokenPluginError
from tests.benchmarks.trials import hostile_estimators as hostile
from tests.short_drive import SET, SHORT

MODULE = "misfits"
LIMITS = Limits(5.0, 3 * 2**29)
# Of all those in the module, the ones that are driven through the commands; and those that need their process to end.
COMMANDS = ("Surrogate", "NoWords", "Long", "OwnBase", "Exits", "Garbage", "Far", "TwoDimensionalIds")
PROCESSES = (
    *("Notes", "Interrupts", "SystemExits", "Segfaults", "LeavesChild", "LeavesOrphan", "Hangs", "HangsInC"),
    *("AnswersOften", "Prints"),
    *("EatsMemory", "ClosesAll", "Pickle", "Constructor", "HangsAtStart", "WarmUpExits"),
)


WORDS = {name: message for name, (_, message) in hostile.ODD.items()}
ANSWERS = [name for name in WORDS if name not in (*COMMANDS, *PROCESSES, "EatsInChildren")]


@pytest.fixture(scope="module")
def external() -> Iterator[ExternalProcesses]:
    """Shared: the process of `Good` must outlive what happens to the others."""
    with ExternalProcesses(LIMITS, one_thread=True) as opened:
        yield opened


def steady(row: dict[str, Any]) -> dict[str, Any]:
    """Return what must not change: a row without its times; absent numbers are None."""
    kept = {key: value for key, value in row.items() if key not in (*COST_KEYS, "estimator", "key")}
    return {key: None if value != value else value for key, value in kept.items()}


def asked(*names: str) -> list[str]:
    return [word for name in names for word in ("--estimator", f"{MODULE}:{name}")]


@cache
def alone() -> list[dict[str, Any]]:
    """Return the rows of `Good` and of dead reckoning without the hostile ones."""
    return run_trials("tiny", [f"{MODULE}:Good", "dead-reckoning"], overrides=SET, on_error="row").to_dict("records")


def check(rows: list[dict[str, Any]]) -> None:
    """The hostile ones have failed in one line each; who answers rightly has the row that `Good` has, without them."""
    found = {row["estimator"].removeprefix(f"{MODULE}:"): row for row in rows}
    for name in found.keys() & WORDS:
        error = found[name]["error"]
        assert found[name]["status"] == "failed" and WORDS[name] in error, (name, error)
        assert "\n" not in error and len(error) < 5000
    good, dead = (steady(row) for row in alone())
    assert good["status"] == "ok" and good["position_rmse_m"] > 0.0
    assert steady(found["dead-reckoning"]) == dead
    for name in found.keys() & {"good", *hostile.HARMLESS}:
        assert steady(found[name]) == good, name
    assert MODULE not in sys.modules


NAMES = ("Patches", "Disturbs", *COMMANDS, "Mutates", "Peeks", "Good")


@pytest.mark.slow
def test_in_run(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    few = ("--json", "--no-figures", "--time-limit", "8", "--memory-limit", "1.5", "--out", "out")
    assert main(["run", "tiny", *SHORT, *asked(*NAMES, "Hangs"), "--estimator", "dead-reckoning", *few]) == 1
    out, err = capfd.readouterr()
    rows = json.loads(out)
    assert f"trial 0, {MODULE}:Disturbs: two" in err
    check(rows)
    assert json.loads((place / "out" / "summary.json").read_text("utf-8"))["rows"] == rows
    longest = (place / "out" / f"error-{MODULE}_Long.txt").read_text("utf-8")
    assert "Traceback" in longest and len(longest) < 30_000
    assert "surrogate" in (place / "out" / f"error-{MODULE}_Surrogate.txt").read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["processes", "serial"])
def test_in_sweep(place: Path, executor: str) -> None:
    few = ("--quiet", "--time-limit", "60", "--memory-limit", "1.5", "--jobs", "1", "--executor", executor)
    names = ("Patches", "Exits", "Disturbs", "Surrogate", "Good")
    words = ["sweep", "tiny", *SHORT, *asked(*names), "--estimator", "dead-reckoning", *few, "--out", "out"]
    assert main(words) == 1
    check(results(place / "out").to_dict("records"))
    with sqlite3.connect(place / "out" / DATABASE) as database:
        (length,) = database.execute("SELECT max(length(traceback)) FROM rows").fetchone()
    database.close()
    assert length < 30_000


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
def test_a_process_that_ends_or_hangs(
    place: Path,
    external: ExternalProcesses,
    toy_recording: Callable[..., Recording],
    capfd: pytest.CaptureFixture[str],
    name: str,
) -> None:
    asked_for = [external_request(f"{MODULE}:{one}", None, False) for one in (name, "Good")]
    bad, good = score_recording(toy_recording(), "toy", asked_for, 0, 0, external=external).outcomes
    assert bad.row["status"] == "failed" and WORDS[name] in bad.row["error"], bad.row["error"]
    assert bad.lost == ("its process" in WORDS[name] or "no answer" in WORDS[name])
    assert good.row["status"] == "ok", good.row["error"]
    assert not Path("pickled").exists()
    if name == "LeavesOrphan" and sys.platform == "linux":
        assert not psutil.pid_exists(int(Path("orphan").read_text()))
    if name == "Prints" and sys.platform == "linux":
        printed = capfd.readouterr().err
        assert printed.endswith("last words") and len(printed) < 1.1 * MOST_PRINTED


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_that_is_none(toy_recording: Callable[..., Recording], name: str) -> None:
    (outcome,) = score_recording(toy_recording(), "toy", [Request(name, getattr(hostile, name), None)], 0, 0).outcomes
    assert outcome.row["status"] == "failed" and WORDS[name] in outcome.row["error"], outcome.row["error"]
    assert not outcome.lost


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what other processes hold")
def test_the_memory_of_all_that_a_process_starts_counts(place: Path, toy_recording: Callable[..., Recording]) -> None:
    asked_for = external_request(f"{MODULE}:EatsInChildren", None, False)
    with ExternalProcesses(Limits(60.0, 3 * 2**28), one_thread=True) as external:
        (bad,) = score_recording(toy_recording(), "toy", [asked_for], 0, 0, external=external).outcomes
    assert WORDS["EatsInChildren"] in bad.row["error"], bad.row["error"]


@pytest.mark.parametrize("apart", [True, False])
def test_who_says_that_it_needs_the_future_gets_it(
    place: Path, external: ExternalProcesses, toy_recording: Callable[..., Recording], apart: bool
) -> None:
    asked_for = external_request(f"{MODULE}:Foresees", None, False) if apart else Request("F", hostile.Foresees, None)
    (outcome,) = score_recording(toy_recording(), "toy", [asked_for], 0, 0, external=external).outcomes
    assert outcome.row["status"] == "ok", outcome.row["error"]
    assert outcome.result is not None and outcome.result.remarks == ("0 left",)


def test_a_module_that_is_never_imported_costs_the_time_limit(place: Path) -> None:
    (place / "deadlock.py").write_text("import threading; threading.Event().wait()")
    (request,) = requests({}, ["deadlock:X"], limit_s=1.5)
    with pytest.raises(BrokenPluginError, match=r"its module cannot be imported: no answer in 1.5 s"):
        request.estimator(None)


@pytest.mark.slow
def test_no_more_processes_than_allowed(
    place: Path, toy_recording: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(external_processes, "MOST_PROCESSES", 1)
    names = ("Good", "Mutates", "Good")
    asked_for = [external_request(f"{MODULE}:{name}", None, False) for name in names]
    with ExternalProcesses(LIMITS, one_thread=True) as external:
        outcomes = score_recording(toy_recording(), "toy", asked_for, 0, 0, external=external).outcomes
        assert [outcome.row["status"] for outcome in outcomes] == ["ok"] * 3 and len(external._alive) == 1


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import os; os._exit(4)", "its process ended with exit status 4"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    ],
)
def test_a_module_that_cannot_be_imported(place: Path, source: str, words: str) -> None:
    (place / "at_import.py").write_text(source)
    bad, good = run_trials("tiny", ["at_import:X", "dead-reckoning"], overrides=SET, on_error="row").to_dict("records")
    assert (bad["status"], good["status"]) == ("failed", "ok")
    assert f"its module cannot be imported: {words}" in bad["error"]


@pytest.mark.slow
def test_what_is_patched_at_import_stays_there(place: Path) -> None:
    patch = "from cellslam.benchmarks.scores import metrics\nmetrics.score = lambda *_: {}\n"
    (place / "patching.py").write_text(f"{hostile.MISFITS}\n{patch}", "utf-8")
    rows = run_trials("tiny", ["patching:Good", "dead-reckoning"], overrides=SET, on_error="row").to_dict("records")
    assert all(row["position_rmse_m"] > 0.0 for row in rows)


@pytest.mark.parametrize(
    "message",
    [b"", b"\n", b"[]\n", b'{"columns": [["pose", "O", [1]]]}\n', b'{"columns": [["pose", "<f8", [-1]]]}\n12345678',
     b'{"columns": [["pose", "<f8", [99999999999, 99999999999]]]}\n', b'{"columns": 3}\n', b"[" * 100_000],
)  # fmt: skip
def test_bytes_that_are_no_message_are_refused(message: bytes) -> None:
    with pytest.raises(ValueError, match="not a message"):
        decoded(message)
