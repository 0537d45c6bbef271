"""The results of a sweep as one table: a row a trial and estimator, and a column for each key that varies."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from sqlite3 import Connection
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.benchmarks.sweeps.store import check_rows, reading, stored_columns
from cellslam.benchmarks.sweeps.tasks import identity
from cellslam.scenarios.keys import label, nearest_key
from cellslam.scenarios.scenario import MapConfig
from cellslam.sim.errors import InputError, one_line
from cellslam.slam.registry import BUILT_IN

if TYPE_CHECKING:
    import pandas as pd

_IDS = ("key", "world", "options")


def results(folder: str | Path, keys: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the rows of a sweep's folder as a DataFrame, also while the sweep is running.

    Columns: `key`, those of a row (`ROW_KEYS`), and every scenario key and estimator option that has more than
    one value (`estimator.fastslam.particles` is null in the rows of other estimators); of several scenarios, what the
    scenario's name determines is left out. `keys`: these row and scenario keys alone, or `world` and `options`: ids of
    what a row was made from. Rows are ordered by scenario, its settings, estimator, trial. Raises InputError.
    """
    import pandas as pd

    with reading(Path(folder)) as database:
        check_rows(Path(folder), database)
        pairs, columns = _settings(database)
        wanted = _wanted(keys, columns)
        plain = ["key", "estimator", "world", "options", "seed", "trial", *(k for k in ROW_KEYS if k in wanted)]
        plain = list(dict.fromkeys(plain))
        there = stored_columns(database)
        names = ", ".join(f'"{name}"' if name in there else "NULL" for name in plain)
        rows = database.execute(f"SELECT {names} FROM rows").fetchall()
    frame = pd.DataFrame.from_records(rows, columns=plain)
    place = {pair: index for index, pair in enumerate(pairs)}
    # Estimator, world and options come after the key.
    index = [place[row[1:4]] for row in rows]
    settings = {name: [columns[name][i] for i in index] for name in wanted if name not in plain}
    frame = pd.concat([frame, pd.DataFrame(settings, index=frame.index, columns=list(settings))], axis=1)
    order = [name for name in ("scenario", *settings) if name in frame and _sortable(columns.get(name, ()))]
    frame = frame.sort_values([*order, "estimator", "options", "seed", "trial"], kind="stable", ignore_index=True)
    return frame[["key", *wanted]] if keys is None else frame[list(wanted)]


def oracles(folder: Path) -> frozenset[str]:
    """Return the estimators of a store that were shown the truth, as its rows say: none is loaded for that."""
    known = {entry.name for entry in BUILT_IN if entry.oracle}
    with reading(folder) as database:
        if "oracle" in stored_columns(database):  # not in stores made before rows said so
            known |= {name for (name,) in database.execute("SELECT DISTINCT estimator FROM rows WHERE oracle")}
    return frozenset(known)


def varying_keys(folder: str | Path) -> list[str]:
    """Return the scenario keys and options that have more than one value among the rows. Raises InputError.

    Where there are several scenarios, `scenario` stands for all that its name determines.
    """
    with reading(Path(folder)) as database:
        return _varied(_settings(database)[1])


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys and values of nested tables; items of a list are called by name or index."""
    for name, value in table.items():
        if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            value = {label(item, index): item for index, item in enumerate(value)}
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def provenance(folder: Path) -> list[dict[str, Any]]:
    """Return the commands that wrote into a sweep's folder: when, where, with which versions."""
    with reading(folder) as database:
        rows = database.execute("SELECT started, host, command, versions FROM runs ORDER BY id").fetchall()
    try:
        return [{"started": s, "host": h, "command": c, "versions": json.loads(v)} for s, h, c, v in rows]
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{folder}: damaged: what wrote the results cannot be read ({one_line(error, 160)})"
        ) from error


def _settings(database: Connection) -> tuple[list[tuple[str, str, str]], dict[str, list[Any]]]:
    """Return each (estimator, world, options) of the rows, and the value of every scenario key and option for each."""
    pairs = database.execute("SELECT DISTINCT estimator, world, options FROM rows").fetchall()
    try:
        worlds, options = _tables(database, "worlds", "world"), _tables(database, "options", "options")
        for world in worlds.values():
            world["map"] = dict(MapConfig()) | world.get("map", {})  # a world says nothing of a map or of one car
            world["scenario"] = world.pop("name")
        flat_worlds = {i: dict(flat(world)) for i, world in worlds.items()}
        settings = [
            flat_worlds[world] | dict(flat(options[option] or {}, f"estimator.{estimator}."))
            for estimator, world, option in pairs
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        what = one_line(f"{type(error).__name__}: {error}", 160)
        raise InputError(f"the results are damaged: what they were made from cannot be read ({what})") from error
    known = dict.fromkeys(key for setting in settings for key in setting)
    return pairs, {key: [_scalar(setting.get(key)) for setting in settings] for key in known}


def _tables(database: Connection, table: str, column: str) -> dict[str, Any]:
    """Return the worlds or options that rows name in a column, by id. Raises ValueError where one is not that of its
    id."""
    found = dict(database.execute(f"SELECT id, tables FROM {table} WHERE id IN (SELECT {column} FROM rows)"))
    for name, tables in found.items():
        if identity(tables) != name:
            raise ValueError(f"'{name}' is not the digest of its tables")
    return {name: json.loads(tables) for name, tables in found.items()}


def _wanted(keys: Sequence[str] | None, columns: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return the keys that are asked for, checked; None: those of a row, and those that vary."""
    if keys is None:
        return list(dict.fromkeys((*ROW_KEYS, *_varied(columns))))
    for key in keys:
        if key not in {*ROW_KEYS, *_IDS, *columns}:
            near = nearest_key(key, [*ROW_KEYS, *columns])
            hint = f"; did you mean '{near}'?" if near else ""
            there = ", ".join(_varied(columns)) or "none"
            raise InputError(f"unknown key '{key}'{hint} (keys that vary here: {there})")
    return list(dict.fromkeys(keys))


def _varied(columns: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return the keys that have more than one value; of several scenarios, those that its name does not determine."""
    # Options of one estimator vary if its own rows differ; the rows of others have none.
    pairs = {
        key: {(name, value) for name, value in zip(columns["scenario"], values, strict=True) if value is not None}
        for key, values in columns.items()
    }
    several = [key for key, own in pairs.items() if len({value for _, value in own}) > 1]
    if "scenario" not in several:
        return several
    return ["scenario", *(key for key in several if len(pairs[key]) > len({name for name, _ in pairs[key]}))]


def _scalar(value: Any) -> Any:
    """Return a value that can be grouped by: lists as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _sortable(values: Sequence[Any]) -> bool:
    return len({str if isinstance(v, str) else float for v in values if v is not None}) == 1
