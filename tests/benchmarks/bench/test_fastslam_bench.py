"""`cellslam bench fastslam`: what it counts, and that it runs."""

from __future__ import annotations

import json
import math

import pytest
from numba import njit

from cellslam.benchmarks.bench.fastslam_bench import DENSE, cost_points, dense
from cellslam.benchmarks.bench.roofline import operations_of, rows_written, work_of_update
from cellslam.benchmarks.cli.main import main
from cellslam.slam.fastslam.state.layout import GAIN, RECORD, SIGMA


@njit
def put(rec, first, lane, values):
    for i, value in enumerate(values):
        rec[(first + i) * 32 + lane] = value


@njit
def inner(x):
    return x * x + 1.0


@njit
def outer(rec, w):
    for i in range(32):
        a = rec[3 * 32 + i] - w[(2 + 1) * 32 + i]
        rec[5 * 32 + i] = math.sqrt(max(a, 0.0)) * inner(a)
        rec[6 * 32 + i] += 2.0
        put(rec, SIGMA, i, (a, a, a, a, a, a))
        put(w, GAIN, i, (a, a))


def test_operations_and_written_rows_are_counted_in_the_source() -> None:
    """One difference, a root, a maximum, a product, the two operations of `inner`, one sum; indices are none."""
    assert operations_of(outer) == 7
    assert rows_written(outer) == 2 + 6


def test_work_of_an_update_is_plausible() -> None:
    work = work_of_update()
    assert 800 < work.operations < 2000
    assert work.bytes_read == 4 * RECORD
    assert 4 * 20 <= work.bytes_written < 4 * RECORD


def test_a_dense_link_updates_what_it_measures() -> None:
    row = dense(*DENSE, repeat=1)
    assert row["updates_per_snapshot"] == pytest.approx(DENSE[1], abs=0.2)
    assert row["ns_per_product"] == pytest.approx(1e6 * row["ms_per_snapshot"] / math.prod(DENSE))
    assert len(set(cost_points())) == len(cost_points())


@pytest.mark.parametrize(("landmarks", "measurements"), sorted({(6, 3), *(point[:2] for point in cost_points())}))
def test_it_does_so_at_every_point_of_the_cost(landmarks: int, measurements: int) -> None:
    row = dense(landmarks, measurements, 32, repeat=1)
    assert row["updates_per_snapshot"] == pytest.approx(min(landmarks, measurements), abs=0.2)


def test_command_prints_rows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "fastslam", "--study", "roofline", "--json", "--quiet"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert 0.0 < rows["roofline"][0]["share"] < 1.0
    assert main(["bench", "fastslam", "--repeat", "0"]) == 2


def test_drive_counts_updates(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "fastslam", "--study", "drive", "--scenario", "tiny", "--particles", "64", "--repeat", "1"]
    assert main([*words, "--json", "--quiet"]) == 0
    row = json.loads(capsys.readouterr().out)["drive"][0]
    assert 0.0 < row["updates_per_snapshot"] < row["measurements_per_snapshot"]
    assert main(words) == 0
    assert "x real time" in capsys.readouterr().out
