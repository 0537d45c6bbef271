from __future__ import annotations

import dataclasses
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import colour_of
from cellslam.benchmarks.figures.sweep.sweep_data import CurveChoice, load, sweep_lines
from cellslam.benchmarks.figures.sweep.sweep_figures import bound_lines, draw_curve, draw_sweep
from cellslam.benchmarks.sweeps.store import DATABASE
from cellslam.benchmarks.sweeps.tasks import Job, Task, identity, request_of
from cellslam.benchmarks.sweeps.trajectories import pack, trajectory
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.sim.recording import Recording
from tests.benchmarks.made_up_sweeps import made_up, plan_of

ALL = {"sweep", "error_cdf", "map_error", "error_time", "clock_offset", "ranks", "stanford", "time_accuracy"}
ALL |= {f"consistency-radio.load-{load}" for load in ("0.01", "1")}


@pytest.fixture
def folder(tmp_path: Path, toy_recording: Callable[..., Recording]) -> Path:
    """A sweep over loads with made-up scores, and trajectories of dead reckoning on the toy recording."""
    recording, drawn = toy_recording(), np.random.default_rng(0)
    result = estimate(recording, request_of(Job("", "dead-reckoning", "dead-reckoning", "null")), drawn)
    offsets = {"clock_offset_m": drawn.normal(size=(40, 2)), "clock_offset_variance_m2": np.ones((40, 2))}
    packed = pack(trajectory(recording, dataclasses.replace(result, **offsets), None))

    def row(task: Task, job: Job) -> dict[str, Any]:
        if task.trial == 2:
            return {"status": "failed"}
        bound = task.trial + json.loads(task.world)["radio"]["load"]
        scores = {"position_rmse_m": drawn.gamma(4.0), "map_gospa_m": 3.0, "bound_position_rmse_m": bound}
        return {**scores, "estimate_seconds": drawn.gamma(2.0)}

    made = plan_of({"grid": {"radio.load": [0.01, 1.0]}}, ("dead-reckoning", "fastslam"), 6)
    return made_up(tmp_path / "sweep", made, row, lambda task, _: packed if task.trial != 2 else None)


@pytest.mark.slow
def test_every_figure_is_drawn_as_png_and_pdf(folder: Path, tmp_path: Path) -> None:
    written = draw_sweep(folder, tmp_path / "out", CurveChoice(metric="position_rmse_m", statistic="rmse"))
    assert {path.name for path in written} == {f"{name}.{kind}" for name in ALL for kind in ("png", "pdf")}
    assert all(path.stat().st_size > 3000 for path in written)
    again = draw_sweep(folder, tmp_path / "again", CurveChoice(statistic="rmse"), formats=("png",))
    assert [p.read_bytes() for p in again] == [(tmp_path / "out" / p.name).read_bytes() for p in again]


@pytest.mark.parametrize(("metric", "bounds"), [("position_rmse_m", [[3.01, 4.0]]), ("map_gospa_m", [])])
def test_the_bound_of_the_drives_is_in_the_curve(folder: Path, metric: str, bounds: list[list[float]]) -> None:
    figure = Figure()
    assert draw_curve(figure, load(folder), CurveChoice(metric=metric), "radio.load")
    drawn = [line for line in figure.axes[0].get_lines() if line.get_label() == "Cramér-Rao bound"]
    assert [list(line.get_ydata()) for line in drawn] == [pytest.approx(values) for values in bounds]
    assert all(list(line.get_xdata()) == [0.01, 1.0] for line in drawn)
    assert to_hex(colour_of("fastslam")) in {to_hex(line.get_color()) for line in figure.axes[0].get_lines()}


def test_of_lines_that_coincide_all_are_seen(folder: Path) -> None:
    figure = Figure()
    assert draw_curve(figure, load(folder), CurveChoice(), "radio.load")
    above, below = sorted((c.lines[0] for c in figure.axes[0].containers), key=lambda line: -line.get_zorder())
    assert above.get_marker() != below.get_marker() and above.get_linewidth() < below.get_linewidth()


def test_worlds_that_differ_in_more_than_x_have_bounds_of_their_own(folder: Path) -> None:
    lines = sweep_lines(load(folder), "radio.load")
    bounds = bound_lines(lines, "bound_position_rmse_m", x="another key")
    assert list(bounds) == ["Cramér-Rao bound, radio.load = 0.01", "Cramér-Rao bound, radio.load = 1"]
    assert [list(points) for points in bounds.values()] == [[0.01], [1.0]]


@pytest.mark.parametrize("other", [2.0, "a text"])
def test_a_world_without_the_swept_key_stands_apart(folder: Path, other: float | str) -> None:
    made_up(folder, plan_of({"grid": {"radio.load": [0.5]}}, ("fastslam",), 2), lambda *_: {"position_rmse_m": 1.0})
    said = {0.01: {"load": 0.01}, 0.5: {}, 1.0: {"load": other}}
    with closing(sqlite3.connect(folder / DATABASE)) as database, database:
        for key, text in database.execute("SELECT id, tables FROM worlds").fetchall():
            tables = json.dumps({"name": "tiny", "radio": said[json.loads(text)["radio"]["load"]]})
            database.execute("UPDATE worlds SET id = ?, tables = ? WHERE id = ?", (identity(tables), tables, key))
            database.execute("UPDATE rows SET world = ?, digest = NULL WHERE world = ?", (identity(tables), key))
    lines = sweep_lines(load(folder), "radio.load")
    if other == 2.0:
        assert [at for at, _ in lines["fastslam"]] == [0.01, 2.0]
        assert [at for at, _ in lines["fastslam, without radio.load"]] == [None]
        figure = Figure()
        assert draw_curve(figure, load(folder), CurveChoice(), "radio.load")
        (level,) = (line for line in figure.axes[0].get_lines() if "fastslam, without" in str(line.get_label()))
        assert list(level.get_ydata()) == [1.0, 1.0]  # the same everywhere
    else:
        assert {at for at, _ in lines["fastslam"]} == {"0.01", "a text", "-"}


def test_along_what_is_no_number_nothing_leads_from_one_to_the_next(tmp_path: Path) -> None:
    fronts = ["statistical", "signal"]
    made = plan_of({"grid": {"radio.front_end": fronts}}, ("dead-reckoning", "fastslam"), 3)
    made_up(tmp_path, made, lambda task, _: {"position_rmse_m": 1.0 + task.trial, "bound_position_rmse_m": 0.5})
    figure = Figure()
    assert draw_curve(figure, load(tmp_path), CurveChoice(), "radio.front_end")
    (axes,) = figure.axes
    assert sorted(label.get_text() for label in axes.get_xticklabels()) == sorted(fronts)
    assert {line.get_linestyle() for line in axes.get_lines() if len(line.get_xdata()) == 2} == {"None"}
    assert axes.get_yscale() == "log"


def test_a_sweep_without_trajectories_or_numbers_gives_what_it_can(tmp_path: Path) -> None:
    made_up(tmp_path, plan_of({}, trials=2), lambda *_: {"position_rmse_m": 1.0, "estimate_seconds": 1.0})
    written = draw_sweep(tmp_path, tmp_path / "figures", formats=("png",))
    assert {path.stem for path in written} == {"error_cdf", "time_accuracy"}
