"""The rows of a suite as a file that can be sent to others, who can add them to a leaderboard and check them."""

from __future__ import annotations

import json
import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.benchmarks.scores.statistics import plain
from cellslam.benchmarks.sweeps.rows import oracles, provenance, results
from cellslam.scenarios.suites import Suite, digest, suite
from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("key", *ROW_KEYS)  # the key is a hash of scenario, estimator, options, seed and trial


@dataclass(frozen=True)
class SuiteRows:
    """Rows of a suite, one a drive and estimator: what of it was run, with which versions, on what machine, which
    estimators are oracles, and which options of estimators were `changed`, as KEY=VALUE."""

    suite: Suite
    scenarios: tuple[str, ...]
    trials: int
    versions: Mapping[str, str]
    machine: str
    oracles: frozenset[str]
    rows: pd.DataFrame
    changed: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether all scenarios and trials of the suite were run."""
        return self.trials == self.suite.trials and self.scenarios == self.suite.scenarios

    @property
    def result(self) -> bool:
        """Whether these rows are the suite's result: all of it, with the options that estimators have themselves."""
        return self.whole and not self.changed

    @property
    def panels(self) -> dict[str, pd.DataFrame]:
        """The rows of each scenario."""
        return {name: self.rows[self.rows["scenario"] == name] for name in self.scenarios}


def stored(
    folder: Path,
    one: Suite,
    scenarios: Sequence[str],
    trials: int,
    keys: Collection[str],
    changed: Sequence[str] = (),
) -> SuiteRows:
    """Return the rows of these `keys` in a store, which are what was run of a suite: `scenarios` and first `trials`,
    with the options `changed`, as KEY=VALUE."""
    rows = results(folder, COLUMNS)
    rows = rows[rows["key"].isin(keys)]
    versions = provenance(folder)[-1]["versions"]
    marked = oracles(folder) & {*rows["estimator"]}
    return SuiteRows(one, tuple(scenarios), trials, versions, platform.machine(), marked, rows, tuple(changed))


def as_text(some: SuiteRows) -> str:
    """Return the rows of a whole suite as JSON, with its digest, a row a line. Raises InputError for a part of one, and
    for changed options."""
    if not some.result:
        text = f"rows of a part of {some.suite.name}, or with changed options, are no entry"
        raise InputError(f"{text}: leave out --trials, --scenario and --set")
    head = {"suite": some.suite.name, "digest": digest(some.suite), "machine": some.machine, "versions": some.versions}
    head["oracles"] = sorted(some.oracles)
    rows = some.rows[list(COLUMNS)].astype(object).to_numpy().tolist()
    six_digits = ([float(f"{v:.6g}") if isinstance(v, float) else v for v in row] for row in rows)
    lines = ",\n".join(json.dumps(list(map(plain, row)), allow_nan=False) for row in six_digits)
    about = json.dumps({**head, "columns": COLUMNS}, indent=1)[:-2]
    return f'{about},\n "rows": [\n{lines}\n]\n}}\n'


def read(path: Path) -> SuiteRows:
    """Return the rows in a file. Raises InputError unless they are of a whole suite that is the same here."""
    import pandas as pd

    try:
        table: Any = json_of(text_of(path))
        frame = pd.DataFrame(table["rows"], columns=table["columns"]).reindex(columns=list(COLUMNS))
        one, stated = suite(str(table["suite"])), str(table["digest"])
        made, machine, marked = dict(table["versions"]), str(table["machine"]), frozenset(table["oracles"])
        found = SuiteRows(one, one.scenarios, one.trials, made, machine, marked, frame)
        estimators = frame["estimator"].unique()
        drives = sorted(zip(frame["estimator"], frame["scenario"], frame["trial"], strict=True))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise InputError(f"{path}: {error}") from error
        raise InputError(f"{path}: not rows of a suite, as 'cellslam bench accuracy --rows' writes them") from error
    if stated != digest(one):
        raise InputError(f"{path}: made with another {one.name} (digest {stated[:12]}, here {digest(one)[:12]})")
    every = sorted((e, s, t) for e in estimators for s in one.scenarios for t in range(one.trials_of(s)))
    if drives != every or set(frame["seed"]) != {one.seed}:
        raise InputError(f"{path}: not every drive of {one.name} once for each estimator")
    return found
