"""No figure changes unnoticed: the rows of every deterministic estimator against stored ones."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.golden import golden_rows

SAME = 1e-6  # relative, on the versions and the processor that the rows were stored with
# Elsewhere the last bits differ, and on a long drive a filter that resamples or decides between associations may take
# another way. On the short drive none does: ranges that differ by 1e-9 m change no count, and no figure by more than
# 1e-9 of it.
OTHER_SHORT, OTHER_LONG, OTHER_DEAD_RECKONING = 1e-3, 0.5, 1e-6


STORED: dict[str, Any] = json.loads(golden_rows.FILE.read_text("utf-8"))


@pytest.fixture(scope="module")
def short_rows() -> dict[str, dict[str, Any]]:
    return golden_rows.rows({golden_rows.SHORT: golden_rows.short()})


@pytest.fixture(scope="module")
def long_rows() -> dict[str, dict[str, Any]]:
    made = golden_rows.drives()
    return golden_rows.rows({name: drive for name, drive in made.items() if name != golden_rows.SHORT})


def check(stored: dict[str, Any], row: dict[str, Any], relative: float, absolute: float) -> None:
    assert row["status"] == "ok" and row.keys() >= stored.keys()  # a new metric spoils no stored row
    for name, value in stored.items():
        if isinstance(value, float):
            assert row[name] == pytest.approx(value, rel=relative, abs=absolute), name
        else:
            assert row[name] == value, name


SHORT = [key for key in STORED["rows"] if key.split()[0] == golden_rows.SHORT]
LONG = [key for key in STORED["rows"] if key not in SHORT]
SAME_MACHINE = STORED["versions"] == golden_rows.versions()


def test_every_estimator_is_stored() -> None:
    assert set(STORED["rows"]) == {f"{d} {e}" for d in golden_rows.DRIVES for e in golden_rows.estimators()}


def test_no_estimator_is_another_one_under_a_second_name() -> None:
    """While clock offsets are wide FastSLAM is the joint filter; it is another one where they are known."""
    keys = ("position_rmse_m", "position_max_m", "nees_mean")
    rows = {
        tuple(STORED["rows"][f"{drive} {name}"][key] for drive in golden_rows.DRIVES for key in keys)
        for name in golden_rows.estimators()
    }
    assert len(rows) == len(golden_rows.estimators())


@pytest.mark.parametrize("key", SHORT)
def test_short_row_is_the_stored_one_on_any_processor(key: str, short_rows: dict[str, dict[str, Any]]) -> None:
    check(STORED["rows"][key], short_rows[key], SAME if SAME_MACHINE else OTHER_SHORT, 1e-9 if SAME_MACHINE else 1e-6)


def test_a_filter_that_is_a_fifth_worse_fails_on_any_processor() -> None:
    row = STORED["rows"][f"{golden_rows.SHORT} ekf-slam"]
    with pytest.raises(AssertionError, match="position_rmse_m"):
        check(row, {**row, "position_rmse_m": 1.2 * row["position_rmse_m"]}, OTHER_SHORT, 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("key", LONG)
def test_long_row_is_the_stored_one(key: str, long_rows: dict[str, dict[str, Any]]) -> None:
    other = OTHER_DEAD_RECKONING if key.endswith(" dead-reckoning") else OTHER_LONG
    check(STORED["rows"][key], long_rows[key], SAME if SAME_MACHINE else other, 0.0 if SAME_MACHINE else 0.05)
