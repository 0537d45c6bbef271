"""The one table in which estimators are compared."""

from __future__ import annotations

from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from cellslam.benchmarks.tables.trials_table import results_table


def text_of(table: Any, width: int = 120) -> str:
    file = StringIO()
    Console(file=file, width=width).print(table)
    return file.getvalue()


def row(name: str, trial: int, error: float | None, **more: Any) -> dict[str, Any]:
    status = "failed" if error is None else "ok"
    return {"estimator": name, "trial": trial, "status": status, "position_rmse_m": error,
            "bound_position_rmse_m": 0.5, **more}  # fmt: skip


def test_one_table_with_intervals_robustness_and_efficiency_ratio() -> None:
    errors = [1.0, 1.1, 0.9, 1.2, 1.0, 1.8]
    rows = [row("mine", t, e, nees_mean=2.5, map_gospa_m=40.0) for t, e in enumerate(errors)]
    rows += [row("seer", t, 0.5, nees_mean=4e11) for t in range(5)] + [row("seer", 5, None)]
    text = text_of(results_table(rows, "title", frozenset({"seer"}), 140), 140)
    mine, seer = (next(line for line in text.splitlines() if line.startswith(name)) for name in (" mine", " seer"))
    # The squares add up to 8.7 m^2, those of six bounds of 0.5 m to 1.5 m^2: sqrt(8.7 / 1.5) = 2.41.
    words = mine.split()
    assert words[:5] == ["mine", "1.05", "[0.95,", "1.50]", "2.41"]
    assert 1.5 < float(words[5].strip("[,")) < 2.41 < float(words[6].strip("],")) < 7.0
    assert words[7:] == ["-", "-", "-", "40.00", "-", "-", "2.50", "-", "0/6", "6/6"]
    assert seer.split()[:5] == ["seer", "(oracle)", "0.50", "[0.50,", "0.50]"]
    assert seer.split()[5] == "1.00"
    assert seer.split()[-4:] == ["4e+11", "-", "1/6", "5/6"]
    assert "oracle: was shown the truth" in text


@pytest.mark.parametrize("width", [80, 100, 130])
def test_a_narrow_window_loses_columns_and_says_which(width: int) -> None:
    more = dict.fromkeys(("position_max_m", "clock_offset_rmse_m", "map_gospa_m", "nees_mean", "realtime_factor"), 1.0)
    rows = [row("oracle-association", t, 1.0, heading_rmse_rad=0.01, **more) for t in range(5)]
    table = results_table(rows, "title", frozenset({"oracle-association"}), width)
    text = text_of(table, width)
    headings = [str(column.header).split()[0] for column in table.columns]
    assert "oracle-association" in text and "…" not in text
    assert headings[:2] == ["estimator", "RMSE"] and {"efficiency", "lost"} <= set(headings)
    missing = {"heading", "GOSPA", "offset", "trials", "max", "NEES", "precision"} - set(headings)
    assert (width < 130) == bool(missing)
    assert all(name in text.split("in a wider window:")[-1] for name in missing)


@pytest.mark.parametrize(("trials", "note"), [(4, "without intervals, which need 5 trials"), (5, "95 % intervals")])
def test_the_note_is_of_the_columns_that_are_shown(trials: int, note: str) -> None:
    rows = [row("mine", t, 1.0 + t) for t in range(trials)]
    plain, merged = (
        " ".join(text_of(results_table([one | more for one in rows], "title", frozenset(), 140), 140).split())
        for more in ({}, {"bound_merged_m": 0.7})
    )
    assert note in plain and ("[" in plain) == (trials == 5)
    assert "with merging" in merged and "with merging" not in plain
