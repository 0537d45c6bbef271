"""Rows of the kernels' arrays: fields lie where their sizes put them, and none on another."""

from __future__ import annotations

import itertools

import pytest

from cellslam.slam.fastslam.state import layout
from cellslam.slam.fastslam.state.layout import Layout, sums_of

WHOLE = {"RECORD_LAYOUT": "RECORD", "STATE_LAYOUT": "THETA", "OUT_LAYOUT": "OUT", "W_LAYOUT": "W_ROWS"}
LONGER = {"RATE_LAYOUT": "RECORD_WITH_RATE"}  # records go on
SHARED = {"GUESS_LAYOUT": ("W_LAYOUT", "W_E")}  # in rows of another's


def faults(name: str) -> list[str]:
    """Return what is wrong with a layout's fields as the kernels know them, by name."""
    own: Layout = getattr(layout, name)
    rows = {field: range(first := getattr(layout, field), first + size) for field, size in own.sizes.items()}
    wrong = [f"{a} and {b} overlap" for a, b in itertools.combinations(rows, 2) if set(rows[a]) & set(rows[b])]
    taken = sorted(row for field in rows.values() for row in field)
    if not wrong and taken != list(range(own.first, own.first + sum(own.sizes.values()))):
        wrong.append("there are gaps")
    return wrong


@pytest.mark.parametrize("name", [n for n in vars(layout) if n.endswith("_LAYOUT")])
def test_fields_follow_one_another(name: str) -> None:
    assert faults(name) == []
    assert name in WHOLE or name in LONGER or name in SHARED
    if name not in SHARED:
        own: Layout = getattr(layout, name)
        assert getattr(layout, {**WHOLE, **LONGER}[name]) == own.first + sum(own.sizes.values())


def test_what_shares_rows_does_so_within_those_it_is_said_to() -> None:
    """A guess takes the place of a pair's innovation and its distance."""
    for name, (whole, field) in SHARED.items():
        assert getattr(layout, name).first == getattr(layout, field)
        assert field in getattr(layout, whole).sizes
    assert layout.W_GUESS + layout.GUESS_LAYOUT.sizes["W_GUESS"] <= layout.W_DET
    assert layout.LONG < layout.BOUND


@pytest.mark.parametrize(("field", "row"), [("GAIN", layout.GAIN - 1), ("W_INV", layout.W_MASK), ("O_C", layout.O_S)])
def test_an_overlap_is_found(monkeypatch: pytest.MonkeyPatch, field: str, row: int) -> None:
    monkeypatch.setattr(layout, field, row)
    name = next(n for n in WHOLE if field in getattr(layout, n).sizes)
    assert any("overlap" in fault for fault in faults(name))


@pytest.mark.parametrize("k", [3, 4, 9])
def test_sums_have_room_for_vectors_and_squares(k: int) -> None:
    at = sums_of(k)
    assert [b - a for a, b in itertools.pairwise(at)] == [1, k, *5 * [k * k], k]
