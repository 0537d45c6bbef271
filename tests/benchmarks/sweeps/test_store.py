from __future__ import annotations

import dataclasses
import itertools
import json
import resource
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.sweeps import store, tasks
from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.store import check_local, only_writer
from cellslam.benchmarks.sweeps.sweeping import pending
from cellslam.benchmarks.sweeps.tasks import Plan, Result, plan, with_contents
from cellslam.benchmarks.sweeps.trajectories import pack, trajectory, unpack
from cellslam.scenarios import sweep_points as sweep
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam.api import VtEstimate
from tests.benchmarks.made_up_sweeps import EMPTY, made_up, plan_of

BOTH = ("fastslam", "dead-reckoning")


def keys(made: Plan) -> list[str]:
    return [job.key for task in made.tasks for job in task.jobs]


def row(key: str, **values: Any) -> Result:
    return Result(key, {**EMPTY, "estimator": "dead-reckoning", **values})


def numbered(start: float = 0.0) -> Callable[..., dict[str, float]]:
    """Rows whose position RMSEs count up."""
    count = itertools.count(start)
    return lambda *_: {"position_rmse_m": next(count)}


@pytest.mark.parametrize("table", [{"map": "file"}, {"city": "path"}, {"": "calibration_file"}])
def test_another_content_of_a_named_file_is_another_job(tmp_path: Path, table: dict[str, str]) -> None:
    file = tmp_path / "named"
    ((name, key),) = table.items()
    text = json.dumps({name: {key: str(file)}} if name else {key: str(file)})
    assert with_contents(text) == text  # there is none
    file.write_bytes(b"one")
    first = with_contents(text)
    assert first != text and first == with_contents(text)
    file.write_bytes(b"two")
    assert with_contents(text) != first


def test_keys_are_of_what_files_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    before = keys(plan_of({}, ("fastslam",)))
    for part in ("city", "gate"):  # of the world, of the options
        monkeypatch.setattr(tasks, "with_contents", lambda text, part=part: text.replace(f'"{part}"', "other"))
        assert keys(plan_of({}, ("fastslam",))) != before


def test_a_world_is_shared_by_all_options_and_estimators() -> None:
    data = {"grid": {"radio.load": [0.1, 0.2], "estimator.fastslam.particles": [5, 6]}}
    made = plan_of(data, BOTH, trials=3)
    assert [(task.trial, len(task.jobs)) for task in made.tasks] == [(n, 3) for n in (0, 0, 1, 1, 2, 2)]
    assert len(made) == len(set(keys(made))) == 18
    assert len(made.worlds) == 2 and len(made.options) == 3


def test_keys_tell_what_decides_a_row_apart_and_nothing_else() -> None:
    same = keys(plan_of({}))[0]
    assert keys(plan_of({"grid": {"estimator.fastslam.particles": [5]}}, BOTH))[1] == same
    assert keys(plan_of({"set": {"title": "another"}}))[0] == same
    others = [
        plan_of({"set": {"radio.load": 0.125}}),
        plan_of({"set": {"name": "other"}}),
        plan_of({}, ("fastslam",)),
        plan_of({"set": {"estimator.fastslam.particles": 7}}, ("fastslam",)),
        plan(sweep.points(sweep.from_tables({"scenario": "tiny"}), BOTH[1:]), 1, 1),
    ]
    assert len({same, keys(plan_of({}, trials=2))[1], *(keys(p)[0] for p in others)}) == 7


def test_rows_come_back_with_the_keys_that_vary(tmp_path: Path) -> None:
    grid = {"radio.load": [0.2, 0.1], "estimator.fastslam.particles": [5, 6]}
    made_up(tmp_path, plan_of({"grid": grid}, BOTH), numbered())
    frame = results(tmp_path)
    assert list(frame.columns) == ["key", *ROW_KEYS, "radio.load", "estimator.fastslam.particles"]
    assert frame["radio.load"].tolist() == [0.1] * 3 + [0.2] * 3
    assert frame["estimator.fastslam.particles"].fillna(-1).tolist() == [5, 6, -1, 5, 6, -1]
    assert frame["position_rmse_m"].tolist() == [3, 5, 4, 0, 2, 1]
    few = results(tmp_path, ["estimator", "radio.detection_scale"])
    assert list(few.columns) == ["estimator", "radio.detection_scale"] and set(few["radio.detection_scale"]) == {1.0}


def test_any_text_is_kept(tmp_path: Path) -> None:
    with store.writing(tmp_path, "command \udcff", {}) as open_store:
        odd = row("a", status="failed", error="lone \ud800, null \0, \x1b")
        open_store.write(dataclasses.replace(odd, traceback="\udfff"), "w", "o")
        found = open_store.database.execute("SELECT error, traceback FROM rows").fetchall()
    assert found == [("lone \\ud800, null \0, \x1b", "\\udfff")]


def test_second_writer_is_refused_with_the_first_ones_name(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from cellslam.benchmarks.sweeps.store import writing\n"
        f"with writing(Path({str(tmp_path)!r}), 'the first command', {{}}):\n"
        "    print('held', flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    first = subprocess.Popen([sys.executable, "-c", script], stdin=pipe, stdout=pipe, text=True)
    assert first.stdout is not None and first.stdout.readline() == "held\n"
    try:
        with pytest.raises(InputError) as error, store.writing(tmp_path, "second", {}):
            raise AssertionError
        assert f"process {first.pid} on" in str(error.value) and "the first command" in str(error.value)
        assert len(results(tmp_path)) == 0
    finally:
        first.kill()
        first.communicate()
    with store.writing(tmp_path, "second", {}):
        assert "second" in (tmp_path / "lock").read_text()


MOUNTS = """\
/dev/vda / ext4 rw 0 0
server:/home /home nfs4 rw 0 0
/dev/vdb /home/me/local\\040disk xfs rw 0 0
sshfs /mnt fuse.sshfs rw 0 0
"""


def test_network_disks_are_refused() -> None:
    for path in ("/tmp/x", "/home/me/local disk/out", "/homes"):
        check_local(Path(path), MOUNTS)
    for path in ("/home/me/out", "/mnt"):
        with pytest.raises(InputError, match=r"network file system \((nfs4|fuse.sshfs)\).*local disk"):
            check_local(Path(path), MOUNTS)


def test_a_full_disk_is_one_line_and_keeps_what_was_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with store.writing(tmp_path, "test", {}) as full:
        full.write(row("a"), "w", "o")
        full.database.execute("PRAGMA max_page_count = 1")
        with pytest.raises(InputError, match="database or disk is full") as error:
            for n in range(1000):
                full.write(row(f"b{n}", error="x" * 1000), "w", "o")
        assert "\n" not in str(error.value) and "kept" in str(error.value)

        def no_space(*_: Any) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(store, "write_durably", no_space)
        with pytest.raises(InputError, match="No space left on device"):
            full.write(dataclasses.replace(row("c"), trajectory=b"x"), "w", "o")
        assert store.statuses(tmp_path)["a"] == "ok" and "c" not in store.statuses(tmp_path)


def test_a_full_disk_costs_the_name_of_the_holder_alone(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        with only_writer(tmp_path, "test"):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_store_that_could_not_be_made_is_begun_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(store, "_TABLES", store._TABLES.replace("EXISTS rows", "EXISTS no table"))
        with pytest.raises(InputError), store.writing(tmp_path, "test", {}):
            raise AssertionError
    made = plan_of({}, trials=2)
    assert len(pending(made, tmp_path, retry_failed=False)) == len(made)
    with store.writing(tmp_path, "test", {}) as again:
        assert store.statuses(again.folder) == {}


def test_lost_trajectories_are_noticed_and_made_again(tmp_path: Path) -> None:
    made = plan_of({}, BOTH, trials=3)
    made_up(tmp_path, made, packed=lambda _, job: job.key.encode() * 9)
    files = {key: store.trajectory_path(tmp_path, key) for key in keys(made)}
    deleted, cut, changed, *_ = files
    files[deleted].unlink()
    files[cut].write_bytes(files[cut].read_bytes()[:50])
    files[changed].write_bytes(files[changed].read_bytes()[:-1] + b"x")
    assert "damaged: 3; they are left out; the command that made them" in store.lost_in_words(tmp_path)
    todo = pending(made, tmp_path, retry_failed=False)
    assert {*keys(todo)} == {deleted, cut, changed}
    without = dataclasses.replace(made, tasks=tuple(dataclasses.replace(t, trajectories=False) for t in made.tasks))
    assert len(pending(without, tmp_path, retry_failed=False)) == 0
    made_up(tmp_path, todo, packed=lambda _, job: job.key.encode() * 9)
    assert store.lost_in_words(tmp_path) == "" and store.trajectory_of(tmp_path, cut) is None  # no trajectory at all
    made_up(tmp_path, made)
    assert store.lost_in_words(tmp_path) == ""  # a row that has none has not lost it


def test_a_changed_row_is_noticed_and_made_again(tmp_path: Path) -> None:
    made, notes = plan_of({}, BOTH, trials=3), list[str]()
    made_up(tmp_path, made, numbered())
    changed = keys(made)[1]
    with closing(sqlite3.connect(tmp_path / store.DATABASE)) as database, database:
        database.execute("UPDATE rows SET position_rmse_m = 7.0 WHERE key = ?", (changed,))
    with pytest.raises(InputError, match="rows that are damaged: 1; the command that made them makes them again"):
        results(tmp_path)
    with store.writing(tmp_path, "test", {}, notes.append) as again:
        todo = pending(made, again.folder, retry_failed=False)
    assert keys(todo) == [changed] and "damaged, and are removed: 1" in notes[0]
    made_up(tmp_path, todo)
    assert len(results(tmp_path)) == 6
    with closing(sqlite3.connect(tmp_path / store.DATABASE)) as database, database:
        database.execute("UPDATE rows SET error = CAST(x'ff' AS TEXT) WHERE key = ?", (changed,))
    with pytest.raises(InputError, match=r"damaged .*recover"), store.writing(tmp_path, "test", {}):
        raise AssertionError
    with closing(sqlite3.connect(tmp_path / store.DATABASE)) as database, database:
        database.execute("UPDATE rows SET error = NULL WHERE key = ?", (changed,))
        database.execute("UPDATE worlds SET tables = replace(tables, '2660000000', '2670000000')")
    with pytest.raises(InputError, match="what they were made from cannot be read"):
        results(tmp_path)


def test_a_trajectory_is_on_the_disk_before_its_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[dict[str, str]] = []
    with store.writing(tmp_path, "test", {}) as open_store:
        durable = store.write_durably

        def noticed(path: Path, content: bytes) -> None:
            durable(path, content)
            found.append(store.statuses(tmp_path))

        monkeypatch.setattr(store, "write_durably", noticed)
        open_store.write(dataclasses.replace(row("a"), trajectory=b"x"), "w", "o")
        assert found == [{}] and store.statuses(tmp_path) == {"a": "ok"}


def test_another_program_that_locks_the_database_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "LOCK_NOTE_S", 0.05)
    with store.writing(tmp_path, "test", {}):
        pass
    other = sqlite3.connect(tmp_path / store.DATABASE, check_same_thread=False, isolation_level=None)
    notes: list[str] = []

    def let_go(text: str) -> None:
        notes.append(text)
        if len(notes) == 2 and other.in_transaction:
            other.execute("ROLLBACK")

    other.execute("BEGIN IMMEDIATE")
    with closing(other), store.writing(tmp_path, "test", {}, let_go) as waited:
        assert len(notes) == 2 and "another program locks it" in notes[0]
        other.execute("BEGIN IMMEDIATE")
        notes.clear()
        waited.write(row("a"), "w", "o")
        assert len(notes) == 2 and store.statuses(tmp_path) == {"a": "ok"}
        monkeypatch.setattr(store, "LOCK_LIMIT_S", 0.1)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(InputError, match="database is locked"):
            waited.write(row("b"), "w", "o")


def test_what_is_no_store_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no results of a run or sweep there"):
        results(tmp_path)
    for name in ("text", "later"):
        (tmp_path / name).mkdir()
    (tmp_path / "text" / store.DATABASE).write_text("some text that is long enough to be no database" * 100)
    with closing(sqlite3.connect(tmp_path / "later" / store.DATABASE)) as other:
        other.execute("CREATE TABLE x (y)")
        other.execute("PRAGMA user_version = 99")
    (tmp_path / "file").touch()
    later = "schema 99, .* still reads it"
    for name, words in (("text", "not a database"), ("later", later), ("file", "is a file, not a folder")):
        with pytest.raises(InputError, match=words), store.writing(tmp_path / name, "test", {}):
            raise AssertionError
    with pytest.raises(InputError, match="cannot be written"), only_writer(tmp_path / "none", "test"):
        raise AssertionError


def test_trajectories_are_kept_compressed(toy_recording: Callable[..., Recording], tmp_path: Path) -> None:
    recording: Recording = toy_recording()
    assert recording.truth is not None
    poses, m = recording.truth.poses + 0.25, recording.measurements
    association = np.where(np.arange(len(m)) >= 5, m.link + 10, -1)
    vts = VtEstimate(np.array([13, 99, 10]), np.array([3, 0, 0]), np.ones((3, 3)), np.tile(np.eye(3), (3, 1, 1)))
    result = TrialResult(
        "x", poses, np.tile(np.eye(6), (40, 1, 1)), association, np.zeros((40, 2)), np.ones((40, 2)), vts
    )
    packed = pack(trajectory(recording, result, None))
    with store.writing(tmp_path, "test", {}) as open_store:
        open_store.write(dataclasses.replace(row("abc"), trajectory=packed), "w", "o")
    got = unpack(store.trajectory_path(tmp_path, "abc"))
    np.testing.assert_allclose(got.poses, poses, atol=1e-6)
    np.testing.assert_allclose(got.error_m, 0.25 * np.sqrt(2), rtol=1e-6)
    np.testing.assert_allclose(got.nees, 0.125, rtol=1e-6)
    np.testing.assert_allclose(got.offset_error_m, np.tile(-recording.truth.clock_offsets_m, (40, 1)), rtol=1e-6)
    first = [m.snapshot[np.flatnonzero(association == one)[0]] for one in (13, 10)]
    assert got.vt_first.tolist() == [first[0], -1, first[1]] and len(got.bound_std_m) == 0
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(packed[:100])
    with pytest.raises(InputError, match="not a trajectory file"):
        unpack(damaged)
    damaged.write_bytes(pack(dataclasses.replace(got, nees=got.nees[1:])))
    with pytest.raises(InputError, match=r"'nees' has the shape \(39,\)"):
        unpack(damaged)


def test_a_store_made_before_a_metric_existed_stays_readable_and_goes_on(tmp_path: Path) -> None:
    made = plan_of({}, trials=2)
    made_up(tmp_path, made, numbered())
    with closing(sqlite3.connect(tmp_path / store.DATABASE)) as database, database:
        database.execute("ALTER TABLE rows DROP COLUMN nees_mean")
    frame = results(tmp_path)
    assert frame["nees_mean"].isna().all() and frame["position_rmse_m"].tolist() == [0.0, 1.0]
    second = dataclasses.replace(made, tasks=made.tasks[1:])
    made_up(tmp_path, second, lambda *_: {"nees_mean": 2.0})
    assert results(tmp_path)["nees_mean"].fillna(-1.0).tolist() == [-1.0, 2.0]


def test_a_damaged_database_is_not_gone_on_with(tmp_path: Path) -> None:
    folder = made_up(tmp_path / "a", plan_of({}, trials=3))
    path = folder / store.DATABASE
    raw = bytearray(path.read_bytes())
    raw[4096:] = b"\xff" * len(raw[4096:])
    path.write_bytes(bytes(raw))
    with pytest.raises(InputError, match=r"damaged .*malformed.*recover") as found:
        results(folder)
    assert "the same command" not in str(found.value)
