"""A legal but long request says what it will take."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

import pytest

from cellslam.cli.output import note_long
from cellslam.scenarios.loading import load


@pytest.mark.parametrize(
    ("keys", "words"),
    [({}, ""), ({"vehicle.duration_s": 20_000.0, "vehicle.snapshot_interval_s": 0.005}, "4000000 snapshots takes 27 m"),
     ({"city.extent_m": 5000.0, "city.block_size_m": 40.0}, "15625 blocks and 6850 snapshots takes 3 minutes at")],
)  # fmt: skip
def test_what_it_will_take(keys: dict[str, Any], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = load("lund-530", keys)
    note_long(Namespace(quiet=False), scenario.city, scenario.vehicle)
    printed = capsys.readouterr().err
    assert words in printed and bool(printed) == bool(words), printed
    note_long(Namespace(quiet=True), scenario.city, scenario.vehicle)
    assert not capsys.readouterr().err
