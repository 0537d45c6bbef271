"""Errors that name the value and the remedy, and what things say of themselves."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam import benchmarks, scenarios, sim
from cellslam.benchmarks.bound.shared_maps import shared_map_bounds
from cellslam.benchmarks.tables.consistency import consistency
from cellslam.recordings.adapters.tui_files import load_sheet, opened
from cellslam.recordings.importing.matlab import variables
from cellslam.scenarios.simulation import drive_through
from cellslam.sim.city.assemble import Part, assemble
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from tests.command_line import Run, refused

DRIVE = Recording.load(str(files("cellslam.slam.conformance").joinpath("conformance_drive.h5")))
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def city_of(corners: Any, triangles: Any = ((0, 1, 2),)) -> Any:
    return assemble("made", [Part(np.asarray(corners), np.asarray(triangles), 0, -1)], [], [], np.zeros(0))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: city_of(CORNERS, np.zeros((0, 3), int)), "has no triangles: give a mesh"),
        (lambda: city_of(CORNERS * np.nan), "vertex 0 of 3 is not finite; repair the mesh"),
        (lambda: city_of(CORNERS * 1e9), "coordinates beyond 1e8 m: expected metres"),
        (lambda: scenarios.load("tiny", {"vehicle.distance_m": np.nan}), "vehicle.distance_m = nan: must be a finite"),
        (lambda: scenarios.load("tiny", {"city.block_size_m": 400.0}), "block_size_m 400.0 is more than half of ext"),
        (lambda: scenarios.load("x" * 5000), "unknown scenario"),
        (lambda: scenarios.load("tiny", {"city.kind": "round"}), "city.kind = 'round': must be 'procedural' or 'mesh'"),
        (lambda: scenarios.load("tiny", {"city": {}}), "'city.kind' is missing"),
        (lambda: scenarios.load("tiny", {"vehicle.waypoints_m": []}), "needs at least 2 items, not 0"),
        (lambda: scenarios.load("tiny", {"vehicle.waypoints_m": [[np.inf, 0.0]]}), "must be a finite number"),
        (lambda: drive_through(np.zeros((9, 3)), 0.1), "are one place: give those of a drive, in order"),
        (lambda: list(shared_map_bounds([replace(DRIVE, truth=None)])), "no truth: the bound needs it"),
        (lambda: consistency("nowhere", times=0), "times = 0: must be at least 1"),
        (lambda: load_sheet(Path()), "no such file; write what the files do not say"),
        (lambda: opened(Path("a.h5"), {}).__enter__(), "a.h5: no such file; download it, or correct its name"),
        (lambda: opened(Path(__file__), {}).__enter__(), "not an HDF5 file, or a damaged one"),
        (lambda: variables(Path("a.mat")), "a.mat: no such file; download or export it first"),
    ],
)
def test_errors_name_the_value_and_the_remedy(call: Callable[[], Any], says: str, tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=re.escape(says)):
        call()


@pytest.mark.parametrize("words", [("run",), ("replay",), ("sweep", "--out", "swept")])
def test_a_name_that_is_too_long_is_one_line(words: tuple[str, ...], cellslam: Run) -> None:
    refused(cellslam(*words, 5000 * "x"), "xxx")


@pytest.mark.parametrize(
    ("sheet", "says"),
    [
        ("", "'clock_offset_std_m' is missing (deviation of the delays' unknown common offset"),
        ("clock_offset_std_m = 0\nodometry = 'simulated'\n", "give one of [paths] and [responses]"),
    ],
)
def test_a_sheet_says_what_it_lacks(sheet: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "tui.toml").write_text(sheet)
    with pytest.raises(InputError, match=re.escape(says)):
        load_sheet(tmp_path)


def test_things_show_themselves_in_few_words() -> None:
    assert DRIVE.truth is not None
    for thing, begin in (
        (DRIVE, f"Recording({len(DRIVE.time_s)} snapshots, "),
        (DRIVE.truth, "Truth(poses=array("),
        (DRIVE.measurements, "Measurements(snapshot=array("),
        (scenarios.load("tiny"), "Scenario('tiny': half a minute"),
    ):
        assert repr(thing).startswith(begin) and len(repr(thing)) < 600


def test_packages_load_their_names_when_these_are_asked_for() -> None:
    assert sim.World.__name__ == "World" and scenarios.Scenario.__name__ == "Scenario"
    for package in (sim, scenarios, benchmarks):
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            package.__getattr__("nothing")
