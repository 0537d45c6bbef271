"""No figure changes unnoticed: the rows of every deterministic estimator against stored ones."""

from __future__ import annotations

import importlib.util
import json
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SAME = 1e-6  # relative, on the versions and the processor that the rows were stored with
# Elsewhere the last bits differ, and a filter that resamples or decides between associations may take another way.
OTHER = {"dead-reckoning": 1e-6}
OTHER_DEFAULT = 0.5


def golden() -> ModuleType:
    spec = importlib.util.spec_from_file_location("golden_rows", Path(__file__).with_name("golden_rows.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GOLDEN = golden()
STORED: dict[str, Any] = json.loads(GOLDEN.FILE.read_text("utf-8"))


@pytest.fixture(scope="module")
def measured() -> dict[str, dict[str, Any]]:
    return GOLDEN.rows()


def test_every_estimator_is_stored() -> None:
    assert set(STORED["rows"]) == {f"{d} {e}" for d in GOLDEN.DRIVES for e in GOLDEN.estimators()}


@pytest.mark.parametrize("one, other", list(combinations(GOLDEN.estimators(), 2)))
def test_no_estimator_is_another_one_under_a_second_name(one: str, other: str) -> None:
    """While clock offsets are wide FastSLAM is the joint filter; it is another one where they are known."""
    keys = ("position_rmse_m", "position_max_m", "nees_mean")
    rows = [
        [STORED["rows"][f"{drive} {name}"][key] for drive in GOLDEN.DRIVES for key in keys] for name in (one, other)
    ]
    assert rows[0] != rows[1]


@pytest.mark.parametrize("key", STORED["rows"])
def test_row_is_the_stored_one(key: str, measured: dict[str, dict[str, Any]]) -> None:
    same = STORED["versions"] == GOLDEN.versions()
    tolerance = SAME if same else OTHER.get(key.split()[1], OTHER_DEFAULT)
    stored, row = STORED["rows"][key], measured[key]
    assert row["status"] == "ok" and row.keys() == stored.keys()
    for name, value in stored.items():
        if isinstance(value, float):
            assert row[name] == pytest.approx(value, rel=tolerance, abs=0.0 if same else 0.05), name
        else:
            assert row[name] == value, name
