"""The store of a sweep: a row a job in an SQLite database, trajectories beside it; one process writes it.

On a local disk that is one database, which is resumed. Each run of a shard has a database of its own in memory, and
puts whole copies of it into the folder of the shard, under a name of its own: nothing is locked or written twice, so
that the folder may be on a network disk. Readers see all databases of a folder as one.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import secrets
import sqlite3
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from cellslam.benchmarks.scores.metrics import COST_KEYS, METRIC_KEYS, ROW_KEYS
from cellslam.benchmarks.sweeps.tasks import Plan, Result
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably

if TYPE_CHECKING:
    from cellslam.benchmarks.sweeps.trajectories import Trajectory

LOCK, DATABASE = "lock", "results.sqlite"
SHARD, RUN = "shard-*-of-*", "run-*.sqlite"  # patterns: folder of a shard, database of one of its runs
CHECKPOINT_S = 60.0  # between copies: what a killed run of a shard loses, against milliseconds a copy
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
    """The open store of the one process that writes it; see `writing` and `writing_shard`.

    `note` gets a line where it waits; `copy`: the file that copies of a database in memory go to.
    """

    folder: Path
    database: sqlite3.Connection
    run: int
    note: Note
    copy: Path | None = None
    copied_s: float = field(default_factory=time.monotonic)

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
                ((key, _, digest),) = _digests(self.database, key=result.key)  # as it is held
                self.database.execute("UPDATE rows SET digest = ? WHERE key = ?", (digest, key))

        self._patiently(insert)
        if time.monotonic() - self.copied_s > CHECKPOINT_S:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Copy a database that is in memory, whole or not at all."""
        if self.copy is not None:
            with _explained(self.folder):
                write_durably(self.copy, self.database.serialize())
        self.copied_s = time.monotonic()

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
            run = _patiently(lambda: _begin(folder, database, command, versions, note), folder, note)
            yield Store(folder, database, run, note)


@contextmanager
def writing_shard(folder: Path, number: int, count: int, command: str, versions: Mapping[str, str]) -> Iterator[Store]:
    """Open a store of its own for this run of a shard, in memory; copies of it go into the shard's folder in `folder`,
    at once, every minute, and at the end.

    Several may be open at the same time, also of one shard. Raises InputError as `writing` does.
    """
    check_folder(folder)
    place = folder / f"shard-{number}-of-{count}"
    with _explained(folder):
        place.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(":memory:")) as database:
        run = _begin(folder, database, command, versions, _silent)
        name = f"run-{datetime.now(UTC):%Y%m%dT%H%M%S%f}-{secrets.token_hex(4)}.sqlite"
        store = Store(folder, database, run, _silent, place / name)
        store.checkpoint()
        try:
            yield store
        finally:
            store.checkpoint()


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
            "on a local disk (workers of --executor dask need not see it), or add --shard 1/1, which locks nothing"
        )


def databases(folder: Path) -> list[Path]:
    """Return the databases in `folder`: that of a whole sweep, then those of runs of its shards, or of one shard, by
    when they began."""
    whole = [folder / DATABASE] if _has_tables(folder / DATABASE) else []
    return whole + sorted((*folder.glob(RUN), *folder.glob(f"{SHARD}/{RUN}")), key=lambda file: file.name)


def _has_tables(file: Path) -> bool:
    """Return whether a database is there, and more than a file whose making failed. Raises InputError."""
    if not file.is_file():
        return False
    with _opened(file, _address(file)) as database:
        return bool(database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the store in `folder` for reading, also while it is written; several databases are read as one.

    Raises InputError, also where two runs of a shard gave different rows.
    """
    files = databases(folder)
    if not files:
        raise InputError(
            f"{folder}: no results of a run or sweep there (no {DATABASE}); 'cellslam sweep ... --out DIR' makes them"
        )
    with _opened(files[0], _address(files[0]) if len(files) == 1 else "file::memory:") as database:
        if len(files) == 1:
            _check_version(files[0], database)
        else:
            _unite(database, files)
        yield database


def statuses(folder: Path) -> dict[str, str]:
    """Return the status of every key that is stored in `folder`, damaged rows aside. Raises InputError."""
    if not databases(folder):
        return {}
    with reading(folder) as database:
        damaged = damaged_rows(database)
        return {key: of for key, of in database.execute("SELECT key, status FROM rows") if key not in damaged}


def rows_per_s(folder: Path) -> float:
    """Return how many rows a second come in from all that still write into `folder`, by when they began and how many
    they have; clocks of machines are taken to agree within a minute. Raises InputError."""
    rate = 0.0
    for file in databases(folder):
        written = max(one.stat().st_mtime for one in (file, Path(f"{file}-wal")) if one.exists())
        with _opened(file, _address(file)) as database:
            last = "SELECT started, (SELECT count(*) FROM rows WHERE run = id) FROM runs ORDER BY id DESC"
            started, rows = database.execute(last).fetchone()
        span = max(written - datetime.fromisoformat(started).timestamp(), 1.0)
        # One that has been silent for long, by its own pace, has ended.
        if rows and time.time() - written < 3.0 * max(CHECKPOINT_S, span / rows):
            rate += rows / span
    return rate


def stored_columns(database: sqlite3.Connection, schema: str = "") -> set[str]:
    """Return the columns that a store has of its rows; metrics that came after it was made are missing."""
    return {column[1] for column in database.execute(f"PRAGMA {schema}table_info(rows)")}


def trajectory_path(folder: Path, key: str) -> Path:
    """Return where the trajectory of a key is kept: all shards have one place."""
    whole = folder.parent if fnmatch(folder.name, SHARD) else folder
    return whole / TRAJECTORIES / key[:2] / f"{key}.npz"


def trajectory_of(folder: Path, key: str) -> Trajectory | None:
    """Return the trajectory of a key; None where there is none that can be read."""
    from cellslam.benchmarks.sweeps.trajectories import unpack

    path = trajectory_path(folder, key)
    with suppress(InputError):
        return unpack(path) if path.exists() else None
    return None


def lost_trajectories(
    folder: Path, database: sqlite3.Connection, among: Collection[str] | None = None
) -> frozenset[str]:
    """Return the keys, `among` these, whose trajectory is missing, or not the one that was written. Raises OSError."""
    if "trajectory_bytes" not in stored_columns(database):  # made before rows said so
        return frozenset()
    query = "SELECT key, trajectory_bytes, trajectory_sha256 FROM rows WHERE trajectory_bytes IS NOT NULL"

    def whole(path: Path, size: int, digest: str) -> bool:
        return path.is_file() and path.stat().st_size == size and _sha256(path.read_bytes()) == digest

    kept = (row for row in database.execute(query) if among is None or row[0] in among)
    return frozenset(key for key, *known in kept if not whole(trajectory_path(folder, key), *known))


def check_rows(folder: Path, database: sqlite3.Connection) -> None:
    """Raise InputError where rows do not hold what was written."""
    if damaged := damaged_rows(database):
        raise InputError(f"{folder}: rows that are damaged: {len(damaged)}; {_AGAIN}")


def damaged_rows(database: sqlite3.Connection, schema: str = "") -> frozenset[str]:
    """Return the keys of rows that do not hold what was written; of those without a digest nothing is known."""
    if "digest" not in stored_columns(database, schema):  # made before rows had one
        return frozenset()
    return frozenset(key for key, stored, held in _digests(database, schema) if stored not in (None, held))


def lost_in_words(folder: Path) -> str:
    """Return how many trajectories of a folder cannot be shown, and the remedy; empty where none is lost."""
    with reading(folder) as database:
        lost = lost_trajectories(folder, database)
    return (
        f"{folder}: trajectories that are missing or damaged: {len(lost)}; they are left out; {_AGAIN}" if lost else ""
    )


def _prepare(folder: Path, database: sqlite3.Connection) -> None:
    if database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        _check_version(folder / DATABASE, database)
    database.execute("PRAGMA journal_mode = WAL")
    # A killed process loses nothing that was committed; a machine that loses power may lose the last rows.
    database.execute("PRAGMA synchronous = NORMAL")
    database.executescript(_TABLES)  # all or none: a disk may be full in between
    for key in set(COLUMNS) - stored_columns(database):  # metrics that came after the store was made
        database.execute(f'ALTER TABLE rows ADD COLUMN "{key}" {_type(key)}')


def _begin(folder: Path, database: sqlite3.Connection, command: str, versions: Mapping[str, str], note: Note) -> int:
    """Make ready a database that is written, and return the number of this run in it."""
    _prepare(folder, database)
    _remove_damaged(folder, database, note)
    made = (time.strftime("%F %T%z"), platform.node(), _storable(command), json.dumps(dict(versions)))
    with database:
        statement = "INSERT INTO runs (started, host, command, versions) VALUES (?, ?, ?, ?)"
        return int(database.execute(statement, made).lastrowid or 0)


@contextmanager
def _opened(file: Path, address: str) -> Iterator[sqlite3.Connection]:
    """Open the database of that address, for reading; `file` is named where it cannot be read."""
    with (
        _explained(file.parent, "read", file.name),
        closing(sqlite3.connect(address, uri=True, isolation_level=None)) as database,
    ):
        yield database


def _address(file: Path) -> str:
    """Return the address under which SQLite reads a database."""
    # Without a log beside it nobody writes, and nothing needs to be written to read: works on a read-only disk.
    quiet = "" if Path(f"{file}-wal").exists() else "&immutable=1"
    return f"{file.absolute().as_uri()}?mode=ro{quiet}"


def _unite(database: sqlite3.Connection, files: Sequence[Path]) -> None:
    """Fill an empty database with the rows of several. Of rows with one key one that did not fail is kept, or the last.

    Raises InputError where two that did not fail differ in more than their costs.
    """
    database.executescript(_TABLES)
    for file in files:
        with _explained(file.parent, "read", file.name):
            database.execute("ATTACH ? AS more", (_address(file),))
            _check_version(file, database, "more.")
            _take_over(database, file)
            database.execute("DETACH more")


def _take_over(database: sqlite3.Connection, file: Path) -> None:
    """Insert what the attached database `more` has, damaged rows aside."""
    database.create_function("is_damaged", 1, damaged_rows(database, "more.").__contains__)
    whole = "(SELECT * FROM more.rows WHERE NOT is_damaged(key))"
    columns = sorted(stored_columns(database, "more.") & {*COLUMNS})
    differing = " OR ".join(
        f'own."{key}" IS NOT other."{key}"' for key in columns if key in ROW_KEYS and key not in COST_KEYS
    )
    found = database.execute(
        f"SELECT own.estimator, own.scenario, own.trial FROM {whole} AS other JOIN rows AS own USING (key) "
        f"WHERE own.status = 'ok' AND other.status = 'ok' AND ({differing})"
    ).fetchone()
    if found:
        raise InputError(
            f"{file}: its row of {found[0]}, {found[1]}, trial {found[2]} is not that of another run: made by another "
            "version, or on another processor? delete this file, and do again what only it has"
        )
    for table in ("worlds", "options"):
        database.execute(f"INSERT OR IGNORE INTO {table} SELECT * FROM more.{table}")
    run = "started, host, command, versions"
    database.execute(f"INSERT INTO runs ({run}) SELECT {run} FROM more.runs EXCEPT SELECT {run} FROM runs")
    database.execute(f"DELETE FROM rows WHERE status <> 'ok' AND key IN (SELECT key FROM {whole})")
    names = ", ".join(f'"{key}"' for key in columns)
    values = ", ".join("here.id" if key == "run" else f'other."{key}"' for key in columns)
    database.execute(
        f"INSERT OR IGNORE INTO rows ({names}) SELECT {values} FROM {whole} AS other "
        f"LEFT JOIN more.runs AS there ON there.id = other.run LEFT JOIN runs AS here USING ({run})"
    )


def _storable(value: Any) -> Any:
    """Return a value as SQLite takes it: of text, what is no Unicode (as in an odd file's name) escaped."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _check_version(file: Path, database: sqlite3.Connection, schema: str = "") -> None:
    found = database.execute(f"PRAGMA {schema}user_version").fetchone()[0]
    if found != SCHEMA:
        raise InputError(
            f"{file}: made by another version of cellslam (schema {found}, expected {SCHEMA}); that one still reads it "
            f"('cellslam table {file.parent} --format csv'), as SQLite does; sweep again into another --out"
        )


def _remove_damaged(folder: Path, database: sqlite3.Connection, note: Note) -> None:
    """Remove the rows that are damaged, so that they are made again."""
    if damaged := damaged_rows(database):
        with database:
            database.executemany("DELETE FROM rows WHERE key = ?", [(key,) for key in damaged])
        if damaged_rows(database):  # a damaged key stands where it is not looked for
            raise sqlite3.DatabaseError("rows in disorder")
        note(f"{folder}: rows that were damaged, and are removed: {len(damaged)}; {_AGAIN}")


def _digests(
    database: sqlite3.Connection, schema: str = "", key: str | None = None
) -> Iterator[tuple[str, str | None, str]]:
    """Yield the key, the digest that is stored and the digest of what is held, of one row or of all.

    A column that is added later, which is null, changes nothing.
    """
    names = ", ".join(f'"{name}"' for name in sorted(stored_columns(database, schema) - {"digest", "run"}))
    query = f"SELECT key, digest, {names} FROM {schema}rows"
    rows = database.execute(query) if key is None else database.execute(f"{query} WHERE key = ?", (key,))
    for found, stored, *row in rows:
        held = repr([value for value in row if value is not None])
        yield found, stored, _sha256(held.encode("utf-8", "backslashreplace"))


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
def _explained(folder: Path, verb: str = "written", name: str = DATABASE) -> Iterator[None]:
    """Turn what the disk refuses into one line."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: results cannot be {verb} ({error.strerror or error}); {_KEPT}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if _kind(error) not in _REFUSALS:
            raise InputError(
                f"{folder / name}: damaged ({error}): 'sqlite3 {folder / name} .recover' may save rows of it; "
                "copy the folder again, or give another --out"
            ) from error
        raise InputError(f"{folder / name}: results cannot be {verb} ({error}); {_KEPT}") from error


def _replace(file: TextIO, text: str) -> None:
    """Put `text` in place of what is in the file; a full disk only costs the name of the holder.

    Past the file's buffer, whose rest would be written when the file is closed.
    """
    with suppress(OSError):
        os.ftruncate(file.fileno(), 0)
        os.write(file.fileno(), text.encode("utf-8", "backslashreplace"))
