"""Making and checking of sets: drive by drive, so that shards and one run give the same bytes.

drive       simulated, packed, a file of its own; one that is there already stays         `make`
finish      who made the last one writes the index, and the card from it                  `finish`
check       every digest, the contract of every drive, the card                           `check`
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.trials.output_files import writing
from cellslam.recordings.sets.card import card
from cellslam.scenarios.sets import CARD, INDEX, RESPONSES, TRUTH, SetDefinition
from cellslam.scenarios.sets.reading import COLUMNS, Drive, Row, index_of
from cellslam.scenarios.simulation import simulate
from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably
from cellslam.sim.recording import Recording, damage
from cellslam.sim.recording.packing import SNAPSHOT
from cellslam.sim.world.responses import write_responses

BOUND = "bound_rmse_m"  # in the provenance of a drive whose bound was computed


def make(one: SetDefinition, folder: Path, number: int = 1, count: int = 1) -> Iterator[int]:
    """Make what is missing of the `number`-th of `count` shares of a set's drives; yield how many files of each drive
    were made. Raises InputError.

    A file of another set, or of another version of this one, is refused.
    """
    for split, trial in one.places[number - 1 :: count]:
        paths = _files(one, folder, split, trial)
        if all(path.exists() for path in paths):
            if _provenance_of(paths[0]).get("world") != one.scenario.world.model_dump(mode="json"):
                raise InputError(
                    f"{paths[0]}: is of another set, or of another version of {one.name}; give another --out"
                )
            yield 0
            continue
        recording = simulate(one.scenario, one.seeds[split], trial)
        if split != "train" and not one.responses:
            known = {BOUND: bound(recording).position_rmse_m}
            recording = replace(recording, provenance={**recording.provenance, **known})
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.stem.endswith(RESPONSES):
                write_responses(path, one.scenario.world, one.seeds[split], trial)
            else:
                (_hidden(recording) if path.parent.name == "test" else recording).save(path, pack=True)
        yield len(paths)


def finish(one: SetDefinition, folder: Path) -> bool:
    """Write index and card, if all drives are there; return whether they are. Raises InputError."""
    paths = [path for place in one.places for path in _files(one, folder, *place)]
    if not all(path.exists() for path in paths):
        return False
    rows = [_row(folder, path) for path in paths]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *map(astuple, rows)])
    index, size = text.getvalue().encode(), sum(path.stat().st_size for path in paths)
    versions = _provenance_of(paths[0])["versions"]
    for name, content in ((INDEX, index), (CARD, card(one, index, rows, size, versions))):
        with writing(folder / name):
            write_durably(folder / name, content)
    return True


def check(folder: Path) -> Iterator[Row]:
    """Yield the rows of a set's index as each is found right: digest, contract, and what the row says.

    Raises InputError where something is not as it was made.
    """
    rows = index_of(folder)
    index = (folder / INDEX).read_bytes()
    try:
        expected = json_of(text_of(folder / CARD))["distribution"][0]["sha256"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"{folder / CARD}: missing or damaged; 'cellslam dataset make' makes it again") from error
    if hashlib.sha256(index).hexdigest() != expected:
        raise InputError(f"{folder / INDEX}: is not the index of the card; 'cellslam dataset make' makes both again")
    for row in rows:
        path = folder / row.file
        if not row.split.endswith(RESPONSES):
            Recording.load(path)
        if _row(folder, path) != row:
            raise InputError(f"{path}: is not the drive of {INDEX}: delete it, and make the set again")
        yield row


def _files(one: SetDefinition, folder: Path, split: str, trial: int) -> list[Path]:
    """Return the files of a drive, the recording first."""
    paths = [folder / split / f"{trial:04}.h5"]
    paths += [folder / TRUTH / f"{trial:04}.h5"] if split == "test" else []
    return paths + ([folder / split / f"{trial:04}{RESPONSES}.h5"] if one.responses else [])


def _row(folder: Path, path: Path) -> Row:
    """Return what the index says of a drive."""
    place, raw = str(path.relative_to(folder)), RESPONSES if path.stem.endswith(RESPONSES) else ""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    row = Row(place, path.parent.name + raw, int(path.stem[:4]), 0, 0, 0, digest, "")
    if raw:
        return row
    snapshot, times = (Drive(path, row)[name].codes for name in (SNAPSHOT, "time_s"))
    most = int(np.bincount(snapshot, minlength=1).max())
    bounded = _provenance_of(path).get(BOUND)
    return replace(
        row, snapshots=len(times), measurements=len(snapshot), most_paths=most,
        bound_rmse_m="" if bounded is None else f"{bounded:.4f}",
    )  # fmt: skip


def _provenance_of(path: Path) -> dict[str, Any]:
    try:
        with damage.opened(path) as file:
            return dict(json.loads(file["provenance"][()]))
    except (InputError, OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: damaged ({error}): delete it, and make the set again") from error


def _hidden(recording: Recording) -> Recording:
    """Return a drive without its truth, and without what says how to simulate it again."""
    kept = {key: value for key, value in recording.provenance.items() if key not in ("seed", "trial", BOUND)}
    return replace(recording, truth=None, provenance=kept)
