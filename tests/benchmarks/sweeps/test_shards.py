"""Sweeps in shards: who does what, what a killed run leaves, what readers see of many databases, job scripts."""

from __future__ import annotations

import dataclasses
import os
import re
import shlex
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest

from cellslam.benchmarks.scores.metrics import COST_KEYS
from cellslam.benchmarks.sweeps import store
from cellslam.benchmarks.sweeps.rows import provenance, results
from cellslam.benchmarks.sweeps.shards import missing, note_shares, shares
from cellslam.benchmarks.sweeps.sweeping import pending
from cellslam.benchmarks.sweeps.tasks import Plan, Result, identity
from cellslam.benchmarks.sweeps.watch import tally_of
from cellslam.cli.job_scripts import HEADS, MOST_SHARDS, script, whole_command
from cellslam.cli.main import main
from cellslam.sim.errors import InputError
from tests.benchmarks.made_up_sweeps import EMPTY, made_up, plan_of
from tests.benchmarks.sweeps.short_sweeps import words
from tests.command_line import Run, refused

BOTH = ("fastslam", "dead-reckoning")
MIXED = {"grid": {"vehicle.duration_s": [50.0, 500.0], "radio.load": [0.1, 0.2]}}


def keys(made: Plan) -> list[str]:
    return [job.key for task in made.tasks for job in task.jobs]


def rmse_of(key: str) -> float:
    return int(key[:6], 16) / 1e6


def shard_of(folder: Path, made: Plan, number: int, count: int, version: str = "0", **row: Any) -> None:
    """Store rows of a shard as one run of it, the RMSE of each made of its key."""
    (part,) = shares(made, count)[number - 1 : number]
    with store.writing_shard(folder, number, count, f"shard {number}", {"cellslam": version}) as one:
        one.declare(part)
        for task, job in ((each, job) for each in part.tasks for job in each.jobs):
            own = {"estimator": job.estimator, "trial": task.trial, "position_rmse_m": rmse_of(job.key)}
            result = Result(job.key, {**EMPTY, **own, **row}, "", job.key.encode())
            one.write(result, identity(task.world), identity(job.options))


def plain(folder: Path) -> Any:
    return results(folder).drop(columns=[*COST_KEYS])


@pytest.mark.parametrize("count", [1, 2, 7, 100])
def test_shards_are_whole_worlds_alike_in_cost_and_the_same_for_all(count: int) -> None:
    made = plan_of(MIXED, BOTH, trials=10)
    parts = shares(made, count)
    assert parts == shares(plan_of(MIXED, BOTH, trials=10), count)
    assert sorted(keys(made)) == sorted(key for part in parts for key in keys(part))
    assert {task for part in parts for task in part.tasks} == set(made.tasks)
    assert all(part.worlds == {identity(t.world): t.world for t in part.tasks} for part in parts)
    durations = [sum(500 if '"duration_s":500' in task.world else 50 for task in part.tasks) for part in parts]
    assert max(durations) - min(durations) <= 500 and (count == 1 or max(durations) < sum(durations))
    assert shares(made, 1) == [made]
    loads = {f'"load":{load}' for load in (0.1, 0.2)}
    assert count > 7 or all(any(load in task.world for task in part.tasks) for part in parts for load in loads)


def test_all_shards_read_as_one_sweep(tmp_path: Path) -> None:
    made, one, many = plan_of(MIXED, BOTH, trials=5), tmp_path / "one", tmp_path / "many"
    made_up(one, made, lambda _, job: {"position_rmse_m": rmse_of(job.key)}, lambda _, job: job.key.encode())
    for number in (3, 1, 2, 1):  # one twice
        shard_of(many, made, number, 3, version=str(number), estimate_seconds=float(number))
    assert plain(many).equals(plain(one)) and store.lost_in_words(many) == ""
    assert sorted({run["versions"]["cellslam"] for run in provenance(many)}) == ["1", "2", "3"]
    with store.reading(many) as database:
        query = "SELECT rows.estimate_seconds, runs.command FROM rows JOIN runs ON run = runs.id"
        assert {f"shard {seconds:.0f}" == command for seconds, command in database.execute(query)} == {True}
    (first,) = {part.parent for part in many.glob("shard-1-of-3/*")}
    assert set(results(first)["key"]) == set(keys(shares(made, 3)[0])) and store.lost_in_words(first) == ""
    assert main(["merge", str(many)]) == 0
    assert plain(many).equals(plain(one))
    for file in many.glob("shard-*/*"):
        file.unlink()
    assert plain(many).equals(plain(one)) and len(pending(made, many, False)) == 0


def test_runs_of_a_shard_that_differ_are_found(tmp_path: Path) -> None:
    made = plan_of({}, BOTH, trials=2)
    shard_of(tmp_path, made, 1, 1, status="failed", position_rmse_m=None, error="killed")
    shard_of(tmp_path, made, 1, 1, status="failed", position_rmse_m=None, error="hangs")
    assert set(results(tmp_path)["error"]) == {"hangs"}  # the last
    assert len(pending(made, tmp_path, retry_failed=True)) == 4 and not pending(made, tmp_path, retry_failed=False)
    shard_of(tmp_path, made, 1, 1)
    shard_of(tmp_path, made, 1, 1, status="failed", position_rmse_m=None, error="killed")
    assert set(results(tmp_path)["status"]) == {"ok"}
    shard_of(tmp_path, made, 1, 1, nees_mean=1.0)
    with pytest.raises(InputError, match=r"run-.*\.sqlite: its row of .*, tiny, trial \d is not that of another run"):
        results(tmp_path)


def test_a_copy_is_whole_and_follows_each_minute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(store.time, "monotonic", lambda: now[0])
    made, place = plan_of({}, trials=3), tmp_path / "shard-1-of-1"
    with store.writing_shard(tmp_path, 1, 1, "test", {}) as one:
        one.copied_s = 0.0
        for n, task in enumerate(made.tasks):
            assert len(store.statuses(tmp_path)) == (0 if n < 2 else 2)
            now[0] += 31.0
            one.write(Result(task.jobs[0].key, EMPTY), "w", "o")
        assert len(store.statuses(tmp_path)) == 2
        (file,) = place.iterdir()
        file.write_bytes(file.read_bytes()[:5000])
        with pytest.raises(InputError, match=rf"{place}.*{file.name}: damaged"), store.reading(tmp_path) as database:
            database.execute("SELECT * FROM rows").fetchall()
    assert len(store.statuses(tmp_path)) == 3


def test_what_is_missing_is_said_with_its_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    made, out = plan_of({}, BOTH, trials=4), str(tmp_path)
    assert main(["merge", out]) == 2 and "no shards there" in capfd.readouterr().err
    note_shares(tmp_path, {f"cellslam x --shard {n + 1}/3": part for n, part in enumerate(shares(made, 3))})
    shard_of(tmp_path, made, 1, 3)
    second = dataclasses.replace(made, tasks=shares(made, 3)[1].tasks[:1])
    shard_of(tmp_path, second, 1, 1)
    assert missing(tmp_path) == {"cellslam x --shard 3/3": (2, 2)}
    assert main(["merge", out]) == 1
    assert "missing: 2 of 2 rows of: cellslam x --shard 3/3\n" in capfd.readouterr().out
    (tmp_path / f"{store.DATABASE}-wal").touch()
    assert main(["merge", out]) == 2 and "another sweep writes there" in capfd.readouterr().err


def test_watch_shows_what_others_have_done(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    made = plan_of({"grid": {"radio.load": [0.1, 0.2], "estimator.fastslam.particles": [5, 6]}}, BOTH, trials=4)
    note_shares(tmp_path, {str(n): part for n, part in enumerate(shares(made, 2))})
    shard_of(tmp_path, made, 1, 2, status="failed", position_rmse_m=None, error="no answer")
    (file,) = tmp_path.glob("shard-*/*")
    began = file.stat().st_mtime
    os.utime(file, (began + 240.0, began + 240.0))
    tally = tally_of(tmp_path)
    assert (tally.total, tally.done) == (24, 12)
    assert tally.errors == {"fastslam: no answer": 8, "dead-reckoning: no answer": 4}
    assert "radio.load=0.1, estimator.fastslam.particles=5, fastslam" in tally.groups
    assert "radio.load=0.2, dead-reckoning" in tally.groups and len(tally.groups) == 6
    assert 0.04 < (tally.elsewhere or 0.0) <= 0.05
    assert main(["watch", str(tmp_path)]) == 0
    out = capfd.readouterr().out
    assert "12 of 24 rows" in out and "12 failed" in out and "8 failed: fastslam: no answer" in out
    os.utime(file, (began - 1e4, began - 1e4))
    assert tally_of(tmp_path).elsewhere == 0.0  # nobody writes any more


@pytest.mark.slow
def test_shards_give_the_rows_of_one_sweep_though_killed_and_doubled() -> None:
    line = [
        sys.executable,
        *["-m", "tools", "shards", "--shards", "6", "--killed", "2", "--doubled", "1", "--trials", "6"],
    ]
    done = subprocess.run(line, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and "are those of one" in done.stdout, done.stdout + done.stderr


@pytest.mark.slow
def test_shards_need_no_locks_and_a_finished_sweep_nothing(
    place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: Path) -> None:
        raise InputError("network")

    monkeypatch.setattr(store, "check_local", refuse)
    line = words("dead-reckoning", more=("--executor", "serial"))
    assert main(line) == 2 and "network" in capfd.readouterr().err
    for number in (1, 2):
        assert main([*line, "--shard", f"{number}/2"]) == 0
    assert main(line) == 0 and len(results("out")) == 2
    assert len(list(Path("out").glob("shard-*/*"))) == 2
    assert main([*line, "--shard", "2/2"]) == 0
    assert len(list(Path("out").glob("shard-*/*"))) == 2  # nothing to do, nothing to keep


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/-2"])
def test_what_is_no_shard_is_refused(text: str, cellslam: Run) -> None:
    refused(cellslam("sweep", "tiny", "--out", "x", "--shard", text), f"'{text}' is no shard: write I/N")


STUBS = {
    "cellslam": 'echo "$PWD $OMP_NUM_THREADS $*" >> calls',
    "parallel": 'echo "${@:1:$#-1}" > options; all="${@:$#}"; for n in $(cat); do bash -c "${all//\\{\\}/$n}"; done',
}


@pytest.mark.parametrize("kind", HEADS)
def test_job_scripts_do_every_shard_once(kind: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_, odd = place / "bin with space", place / "it's here"
    for folder in (bin_, odd):
        folder.mkdir()
    for name, what in STUBS.items():
        (bin_ / name).write_text(f"#!/bin/bash\n{what}\n")
    for file in bin_.iterdir():
        file.chmod(0o755)
    monkeypatch.chdir(odd)
    monkeypatch.setattr(sys, "executable", str(bin_ / "python"))
    asked = ["sweep", "a b.toml", "--script", kind, "--out", "out"]
    text = script(Namespace(script=kind, words=asked, memory_limit=None), 500, 5 * 3600.0, Path("out"))
    (odd / "job.sh").write_text(text)
    assert subprocess.run(["bash", "-n", "job.sh"]).returncode == 0
    if kind == "parallel":
        line = {**os.environ, "PATH": f"{bin_}:{os.environ['PATH']}"}
        assert subprocess.run(["bash", "job.sh", "my hosts"], env=line).returncode == 0
        assert "--sshloginfile my hosts" in (odd / "options").read_text()
    else:
        variable = {"slurm": "SLURM_ARRAY_TASK_ID", "pbs": "PBS_ARRAY_INDEX"}[kind]
        first, last = map(int, re.search(r"(?:--array=|-J )(\d+)-(\d+)\b", text).groups())  # type: ignore[union-attr]
        assert re.search(r"time=00:70:00|time=01:10:00", text) and "4096m" in text.lower()
        for n in range(first, last + 1):
            env = {**os.environ, variable: str(n)}
            assert subprocess.run(["bash", str(odd / "job.sh")], env=env, cwd="/").returncode == 0
    common = f"{odd} 1 sweep a b.toml --out out --jobs 1 --memory-limit 3 --shard"
    assert (odd / "calls").read_text().splitlines() == [f"{common} {n}/10" for n in range(1, 11)]


def test_there_are_as_many_shards_as_jobs_of_half_an_hour_need() -> None:
    def count(kind: str, tasks: int, seconds: float) -> int:
        text = script(Namespace(script=kind, words=[], memory_limit=None), tasks, seconds, Path("out"))
        return int(re.search(r"--shard .*/(\d+)", text)[1])  # type: ignore[index]

    assert count("slurm", 10**6, 41 * 3600.0) == 82
    assert count("slurm", 20, 41 * 3600.0) == 20  # a world is not divided
    assert count("slurm", 10**6, 1e9) == MOST_SHARDS
    assert count("slurm", 10, 5.0) == 1 and count("pbs", 10, 5.0) == 2  # PBS has no arrays of one


def test_a_command_less_its_shard_is_that_of_all() -> None:
    line = ["sweep", "x.toml", "--shard", "1/2", "--quiet", "--script=slurm", "--shard=3/4", "--out", "--"]
    assert shlex.join(whole_command(line)) == "cellslam sweep x.toml --quiet --out --"
