"""The store of a sweep: one SQLite database in a folder, a row a job, trajectories beside it; one process writes it."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import sqlite3
import time
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from cellslam.benchmarks.scores.metrics import COST_KEYS, METRIC_KEYS, ROW_KEYS
from cellslam.benchmarks.sweeps.tasks import Plan, Result
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably

if TYPE_CHECKING:
    from cellslam.benchmarks.sweeps.trajectories import Trajectory

LOCK, DATABASE = "lock", "results.sqlite"
TRAJECTORIES = "trajectories"
SCHEMA = 4
# Columns beside those of a row: ids of world and options, whether its estimator was shown the truth, which process
# wrote it, size and SHA-256 of its trajectory, null where it has none, and the digest of them all.
OWN_KEYS = ("key", "world", "options", "oracle", "run", "traceback", "trajectory_bytes", "trajectory_sha256", "digest")
COLUMNS = (*OWN_KEYS, *ROW_KEYS)
NETWORK_DISKS = frozenset(
    (
        *("nfs", "nfs4", "cifs", "smb", "smb2", "smb3", "smbfs", "ncpfs", "afs", "davfs", "9p"),
        *("lustre", "gpfs", "beegfs", "ceph", "glusterfs", "panfs", "pvfs2", "orangefs"),
        *("fuse.sshfs", "fuse.glusterfs", "fuse.ceph", "fuse.s3fs", "fuse.rclone", "fuse.davfs2"),
    )
)
_KEPT = "what was finished before is kept, and the same command goes on from there"
_AGAIN = "the command that made them makes them again"
_NUMBERS = (*METRIC_KEYS, "duration_s", "distance_m", *COST_KEYS)
_WHOLE = ("trial", "seed", "snapshots", "oracle", "run", "trajectory_bytes")
_NOT_IN_DIGEST = ("digest", "run")
# What others refuse: a lock, the disk, the system. Any other error is one of the database itself.
_REFUSALS = frozenset(
    (
        *(sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY),
        *(sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_NOMEM),
    )
)
# Others may lock the database: a browser of it for as long as somebody types, a backup for a minute.
LOCK_NOTE_S, LOCK_LIMIT_S = 10.0, 600.0
Note = Callable[[str], None]
Answer = TypeVar("Answer")


def _type(key: str) -> str:
    return "REAL" if key in _NUMBERS else "INTEGER" if key in _WHOLE else "TEXT"


_TABLES = f"""
BEGIN IMMEDIATE;
CREATE TABLE IF NOT EXISTS worlds (id TEXT PRIMARY KEY, tables TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS options (id TEXT PRIMARY KEY, tables TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS runs (id INTEGER PRIMARY KEY, started TEXT, host TEXT, command TEXT, versions TEXT);
CREATE TABLE IF NOT EXISTS rows (
    {", ".join(f'"{key}" {_type(key)}' for key in COLUMNS)}, PRIMARY KEY (key)
) WITHOUT ROWID;
PRAGMA user_version = {SCHEMA};
COMMIT;
"""


@dataclass
class Store:
    """The open store of the one process that writes it; see `writing`. `note` gets a line where it waits."""

    folder: Path
    database: sqlite3.Connection
    run: int
    note: Note

    def status(self) -> dict[str, str]:
        """Return the status of every key that is stored."""
        return self._patiently(lambda: dict(self.database.execute("SELECT key, status FROM rows")))

    @cached_property
    def lost(self) -> frozenset[str]:
        """The keys whose trajectory was missing or damaged when the store was opened."""
        return self._patiently(lambda: lost_trajectories(self.folder, self.database))

    def declare(self, plan: Plan) -> None:
        """Keep the worlds and options of a plan, for the tables."""

        def insert() -> None:
            with self.database:
                for table, known in (("worlds", plan.worlds), ("options", plan.options)):
                    self.database.executemany(f"INSERT OR REPLACE INTO {table} VALUES (?, ?)", known.items())

        self._patiently(insert)

    def write(self, result: Result, world: str, options: str) -> None:
        """Keep a result, replacing an earlier one of the same key: first its trajectory, then its row."""
        row: dict[str, Any] = {
            "key": result.key, "world": world, "options": options, "oracle": result.oracle, "run": self.run,
            "traceback": result.traceback, "trajectory_bytes": None, "trajectory_sha256": None, "digest": None,
        }  # fmt: skip
        if result.trajectory is not None:
            with _explained(self.folder):
                path = trajectory_path(self.folder, result.key)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_durably(path, result.trajectory)
            row |= {"trajectory_bytes": len(result.trajectory), "trajectory_sha256": _sha256(result.trajectory)}
        values = {key: _storable(value) for key, value in {**row, **result.row}.items()}
        columns, marks = ", ".join(f'"{key}"' for key in COLUMNS), ", ".join(f":{key}" for key in COLUMNS)

        def insert() -> None:
            with self.database:
                self.database.execute(f"INSERT OR REPLACE INTO rows ({columns}) VALUES ({marks})", values)
                (row,) = _rows(self.database, "WHERE key = ?", result.key)  # as the database holds it
                self.database.execute("UPDATE rows SET digest = ? WHERE key = ?", (_digest(row), result.key))

        self._patiently(insert)

    def _patiently(self, action: Callable[[], Answer]) -> Answer:
        with _explained(self.folder):
            return _patiently(action, self.folder, self.note)


def _silent(text: str) -> None:
    """Note nothing."""


@contextmanager
def writing(folder: Path, command: str, versions: Mapping[str, str], note: Note = _silent) -> Iterator[Store]:
    """Open the store in `folder`, which is made if need be, as its only writer.

    Another program that locks the database is waited for, for minutes, with a `note`. Raises InputError in one line
    when the folder is another process's, on a network disk, read-only, full, or holds something that is no store.
    """
    check_folder(folder)
    check_local(folder)
    with _explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with only_writer(folder, command), _explained(folder):
        database = sqlite3.connect(folder / DATABASE, timeout=LOCK_NOTE_S)
        with closing(database):
            made = (time.strftime("%F %T%z"), platform.node(), _storable(command), json.dumps(dict(versions)))

            def begin() -> int:
                _prepare(folder, database)
                _remove_damaged(folder, database, note)
                with database:
                    statement = "INSERT INTO runs (started, host, command, versions) VALUES (?, ?, ?, ?)"
                    return int(database.execute(statement, made).lastrowid or 0)

            yield Store(folder, database, _patiently(begin, folder, note), note)


@contextmanager
def only_writer(folder: Path, command: str) -> Iterator[None]:
    """Hold `folder` for this process; the system lets go of it however the process ends.

    Raises InputError naming the process that holds it.
    """
    try:
        file = (folder / LOCK).open("a+", encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); give another --out") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            holder = file.read().strip() or "another process"
            raise InputError(f"--out {folder}: in use by {holder}; wait for it or give another --out") from error
        _replace(file, f"process {os.getpid()} on {platform.node()} since {time.strftime('%F %T')} ({command})\n")
        try:
            yield
        finally:
            _replace(file, "")


def check_local(folder: Path, mounts: str | None = None) -> None:
    """Raise InputError if `folder` is on a network file system; `mounts` is the text of /proc/mounts.

    SQLite's locks and shared memory do not work there. Where the system has no such file nothing is checked.
    """
    if mounts is None:
        try:
            mounts = Path("/proc/mounts").read_text("utf-8", "surrogateescape")
        except OSError:
            return
    path, deepest, kind = folder.absolute().resolve(), 0, ""
    for fields in (line.split() for line in mounts.splitlines()):
        # Spaces and the like are written in octal there.
        place = Path(re.sub(r"\\(\d{3})", lambda octal: chr(int(octal[1], 8)), fields[1]))
        if path.is_relative_to(place) and len(place.parts) >= deepest:
            deepest, kind = len(place.parts), fields[2]
    if kind in NETWORK_DISKS:
        raise InputError(
            f"--out {folder}: is on a network file system ({kind}), where the database could be damaged; give a folder "
            "on a local disk: workers elsewhere need not see it, they send their rows to this process"
        )


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the store in `folder` for reading, also while it is written. Raises InputError."""
    file = folder / DATABASE
    if not file.is_file():
        raise InputError(
            f"{folder}: no results of a run or sweep there (no {DATABASE}); 'cellslam sweep ... --out DIR' makes them"
        )
    with _explained(folder, "read"):
        # Without a log beside it nobody writes, and nothing needs to be written to read: works on a read-only disk.
        quiet = "" if Path(f"{file}-wal").exists() else "&immutable=1"
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro{quiet}", uri=True)) as database:
            _check_version(folder, database)
            yield database


def stored_columns(database: sqlite3.Connection) -> set[str]:
    """Return the columns that a store has of its rows; metrics that came after it was made are missing."""
    return {column[1] for column in database.execute("PRAGMA table_info(rows)")}


def trajectory_path(folder: Path, key: str) -> Path:
    """Return where the trajectory of a key is kept."""
    return folder / TRAJECTORIES / key[:2] / f"{key}.npz"


def trajectory_of(folder: Path, key: str) -> Trajectory | None:
    """Return the trajectory of a key; None where there is none that can be read."""
    from cellslam.benchmarks.sweeps.trajectories import unpack

    path = trajectory_path(folder, key)
    with suppress(InputError):
        return unpack(path) if path.exists() else None
    return None


def lost_trajectories(folder: Path, database: sqlite3.Connection) -> frozenset[str]:
    """Return the keys whose trajectory is missing, or not the one that was written. Raises OSError."""
    if "trajectory_bytes" not in stored_columns(database):  # made before rows said so
        return frozenset()
    query = "SELECT key, trajectory_bytes, trajectory_sha256 FROM rows WHERE trajectory_bytes IS NOT NULL"

    def whole(path: Path, size: int, digest: str) -> bool:
        return path.is_file() and path.stat().st_size == size and _sha256(path.read_bytes()) == digest

    return frozenset(key for key, *known in database.execute(query) if not whole(trajectory_path(folder, key), *known))


def check_rows(folder: Path, database: sqlite3.Connection) -> None:
    """Raise InputError where rows do not hold what was written."""
    if damaged := damaged_rows(database):
        raise InputError(f"{folder}: rows that are damaged: {len(damaged)}; {_AGAIN}")


def damaged_rows(database: sqlite3.Connection) -> frozenset[str]:
    """Return the keys of rows that do not hold what was written; of those without a digest nothing is known."""
    if "digest" not in stored_columns(database):  # made before rows had one
        return frozenset()
    return frozenset(row["key"] for row in _rows(database) if row["digest"] not in (None, _digest(row)))


def lost_in_words(folder: Path) -> str:
    """Return how many trajectories of a folder cannot be shown, and the remedy; empty where none is lost."""
    with reading(folder) as database:
        lost = lost_trajectories(folder, database)
    return (
        f"{folder}: trajectories that are missing or damaged: {len(lost)}; they are left out; {_AGAIN}" if lost else ""
    )


def _prepare(folder: Path, database: sqlite3.Connection) -> None:
    if database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        _check_version(folder, database)
    database.execute("PRAGMA journal_mode = WAL")
    # A killed process loses nothing that was committed; a machine that loses power may lose the last rows.
    database.execute("PRAGMA synchronous = NORMAL")
    database.executescript(_TABLES)  # all or none: a disk may be full in between
    for key in set(COLUMNS) - stored_columns(database):  # metrics that came after the store was made
        database.execute(f'ALTER TABLE rows ADD COLUMN "{key}" {_type(key)}')


def _storable(value: Any) -> Any:
    """Return a value as SQLite takes it: of text, what is no Unicode (as in an odd file's name) escaped."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _check_version(folder: Path, database: sqlite3.Connection) -> None:
    found = database.execute("PRAGMA user_version").fetchone()[0]
    if found != SCHEMA:
        raise InputError(
            f"{folder / DATABASE}: made by another version of cellslam (schema {found}, expected {SCHEMA}); that one "
            f"still reads it ('cellslam table {folder} --format csv'), as SQLite does; sweep again into another --out"
        )


def _remove_damaged(folder: Path, database: sqlite3.Connection, note: Note) -> None:
    """Remove the rows that are damaged, so that they are made again."""
    if damaged := damaged_rows(database):
        with database:
            database.executemany("DELETE FROM rows WHERE key = ?", [(key,) for key in damaged])
        if damaged_rows(database):  # a damaged key stands where it is not looked for
            raise sqlite3.DatabaseError("rows in disorder")
        note(f"{folder}: rows that were damaged, and are removed: {len(damaged)}; {_AGAIN}")


def _rows(database: sqlite3.Connection, condition: str = "", *values: str) -> Iterator[dict[str, Any]]:
    """Yield whole rows by column."""
    cursor = database.execute(f"SELECT * FROM rows {condition}", values)
    names = [column[0] for column in cursor.description]
    return (dict(zip(names, row, strict=True)) for row in cursor)


def _digest(row: Mapping[str, Any]) -> str:
    """Return a digest of what a row holds; a column that is added later, which is null, changes nothing."""
    numbers = {key: row[key] for key in sorted(row) if type(row[key]) is float}
    others = [(key, row[key]) for key in sorted(row) if type(row[key]) not in (float, NoneType)]
    named = repr((list(numbers), [one for one in others if one[0] not in _NOT_IN_DIGEST]))
    return hashlib.sha256(named.encode("utf-8", "backslashreplace") + array("d", numbers.values())).hexdigest()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _patiently(action: Callable[[], Answer], folder: Path, note: Note) -> Answer:
    """Return what an action on the database gives, once no other program locks it. Raises sqlite3.OperationalError."""
    end = time.monotonic() + LOCK_LIMIT_S
    while True:
        try:
            return action()
        except sqlite3.OperationalError as error:
            if _kind(error) != sqlite3.SQLITE_BUSY or time.monotonic() > end:
                raise
        note(f"{folder / DATABASE}: another program locks it; waiting until it lets go")


def _kind(error: Exception) -> int:
    """Return the kind of an error, the last byte of its code; damage, where it is of a text that cannot be decoded."""
    return int(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)) & 0xFF


@contextmanager
def _explained(folder: Path, verb: str = "written") -> Iterator[None]:
    """Turn what the disk refuses into one line."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: results cannot be {verb} ({error.strerror or error}); {_KEPT}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if _kind(error) not in _REFUSALS:
            raise InputError(
                f"{folder / DATABASE}: damaged ({error}): 'sqlite3 {folder / DATABASE} .recover' may save rows of it; "
                "copy the folder again, or give another --out"
            ) from error
        raise InputError(f"{folder / DATABASE}: results cannot be {verb} ({error}); {_KEPT}") from error


def _replace(file: TextIO, text: str) -> None:
    """Put `text` in place of what is in the file; a full disk only costs the name of the holder.

    Past the file's buffer, whose rest would be written when the file is closed.
    """
    with suppress(OSError):
        os.ftruncate(file.fileno(), 0)
        os.write(file.fileno(), text.encode("utf-8", "backslashreplace"))
