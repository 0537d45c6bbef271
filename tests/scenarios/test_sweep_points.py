from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.scenarios import sweep_points as sweep
from cellslam.sim.errors import InputError

DR = ("dead-reckoning",)


def settings(data: dict[str, Any], estimators: tuple[str, ...] = DR) -> list[dict[str, Any]]:
    return [dict(p.settings) for p in sweep.points(sweep.from_tables({"scenario": "tiny", **data}), estimators)]


def test_axes_of_the_command_line() -> None:
    assert sweep.grid_axis("radio.load=0.1,1") == ({"radio.load": 0.1}, {"radio.load": 1})
    assert sweep.grid_axis("a.b=x, y") == ({"a.b": "x"}, {"a.b": "y"})
    assert sweep.grid_axis("a.b=[1,2],[3,4]") == ({"a.b": [1, 2]}, {"a.b": [3, 4]})
    for wrong in ("radio.load", "radio.load=", "=1,2", "radio.load=1,,x"):
        with pytest.raises(InputError, match="KEY=VALUE"):
            sweep.grid_axis(wrong)


def test_parts_of_a_file_are_multiplied_last_fastest() -> None:
    data = {
        "grid": {"radio.load": [0.1, 0.2]},
        "zip": {"radio": {"detection_scale": [1, 0.5], "clutter_scale": [1, 2]}},
    }
    got = settings(data)
    assert [tuple(s.values()) for s in got] == [(0.1, 1, 1), (0.1, 0.5, 2), (0.2, 1, 1), (0.2, 0.5, 2)]
    assert list(got[0]) == ["radio.load", "radio.detection_scale", "radio.clutter_scale"]


def test_latin_hypercube_uses_every_part_of_every_range_once() -> None:
    ranges = {"a": {"low": 1.0, "high": 1e4, "scale": "log"}, "b": {"low": -1.0, "high": 1.0}}
    config = sweep.LatinConfig(points=16, seed=3, ranges=ranges)
    axis = sweep.latin_axis(config)
    a, b = (np.sort([point[key] for point in axis]) for key in "ab")
    np.testing.assert_array_equal(np.floor(np.log10(a) / 4 * 16), np.arange(16))
    np.testing.assert_array_equal(np.floor((b + 1) / 2 * 16), np.arange(16))
    assert axis == sweep.latin_axis(config)
    assert axis != sweep.latin_axis(config.model_copy(update={"seed": 4}))


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_latin_integers_are_whole_and_reach_both_ends(scale: str) -> None:
    spans = {"n": {"low": 10.0, "high": 13.0, "integer": True, "scale": scale}}
    values = [p["n"] for p in sweep.latin_axis(sweep.LatinConfig(points=400, ranges=spans))]
    assert all(type(v) is int for v in values)
    assert set(values) == {10, 11, 12, 13}
    if scale == "linear":
        assert [values.count(n) for n in range(10, 14)] == [100] * 4


def test_a_file_is_read_and_told_from_a_scenario(tmp_path: Path) -> None:
    scenario, file = tmp_path / "mine.toml", tmp_path / "sweep.toml"
    preset = Path(__file__).parents[2] / "scenarios/presets/tiny.toml"
    scenario.write_bytes(preset.read_bytes())
    file.write_text('scenario = "mine.toml"\ntrials = 3\nestimators = ["fastslam"]\n[grid]\nradio.load = [0, 1]')
    assert sweep.is_sweep_file(file) and not sweep.is_sweep_file(scenario) and not sweep.is_sweep_file("tiny")
    found = sweep.read(file)
    assert (found.trials, found.estimators) == (3, ("fastslam",))
    assert found.axes == (({"radio.load": 0}, {"radio.load": 1}),)
    assert [p.scenario.name for p in sweep.points(found, DR)] == ["mine", "mine"]


def test_what_a_setting_of_a_list_leaves_out_is_the_scenarios(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(
        'scenario = "tiny"\n[set]\nradio.clutter_scale = 3.0\n[[list]]\nradio.load = 0.25\n[[list]]\n'
        "estimator.fastslam.gate = 16.0\n"
    )
    first, second = sweep.points(sweep.read(file), ("fastslam",))
    default = sweep.points(sweep.Sweep("tiny"), ("fastslam",))[0].scenario.world.radio.load
    assert first.settings == {"radio.load": 0.25, "estimator.fastslam.gate": 36.0}
    assert second.settings == {"radio.load": default, "estimator.fastslam.gate": 16.0}


WRONG = {
    "key": ({"grid": {"radio.laod": [1]}}, "unknown key 'radio.laod'; did you mean 'radio.load'"),
    "value": ({"grid": {"radio.load": [0.5, 7]}}, "radio.load = 7: must be 0 to 1"),
    "twice": ({"grid": {"radio.load": [1]}, "zip": {"radio.load": [1]}}, "radio.load is swept twice"),
    "set": ({"grid": {"radio.load": [1]}, "set": {"radio.load": 0.5}}, "radio.load is swept, and set to 0.5"),
    "estimator": ({"grid": {"estimator.fastslam.particles": [1]}}, "'fastslam' is not among the estimators"),
    "range": ({"latin": {"points": 2, "ranges": {"radio.load": {"low": 1, "high": 0}}}}, "needs low < high"),
    "size": ({"grid": {f"k{i}": list(range(100)) for i in range(3)}}, "the sweep has 1000000 points"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_wrong_is_said_in_one_line(kind: str) -> None:
    data, words = WRONG[kind]
    with pytest.raises(InputError) as error:
        settings(data)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text('scenario = "tiny"\n[latin]\npoints = 0\nranges = {}')
    with pytest.raises(InputError, match=r"s.toml: latin.points = 0"):
        sweep.read(file)
