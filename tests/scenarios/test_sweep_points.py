from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.trials.trials import DEFAULT_ESTIMATORS
from cellslam.cli.commands.sweep import requested
from cellslam.cli.main import build_parser
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
    assert settings({"list": [{"radio": {"load": 0.3}}, {"radio.load": 0.7}]}) == [
        {"radio.load": 0.3},
        {"radio.load": 0.7},
    ]


def test_points_carry_scenario_and_options() -> None:
    data = {
        "scenario": "tiny",
        "set": {"radio": {"load": 0.25}},
        "grid": {"radio.clutter_scale": [0.5], "estimator.fastslam.particles": [7, 9]},
    }
    points = sweep.points(sweep.from_tables(data), ("fastslam", *DR))
    assert [p.requests[0].options.particles for p in points] == [7, 9]
    assert {p.scenario.world.radio.load for p in points} == {0.25}
    assert points[0].scenario.world == points[1].scenario.world


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
    file.write_text(
        'scenario = "mine.toml"\ntrials = 3\nseed = 5\nestimators = ["fastslam"]\n[grid]\nradio.load = [0, 1]'
    )
    assert sweep.is_sweep_file(file) and not sweep.is_sweep_file(scenario) and not sweep.is_sweep_file("tiny")
    found = sweep.read(file)
    assert (found.trials, found.seed, found.estimators, found.swept) == (3, 5, ("fastslam",), ("radio.load",))
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
    "empty": ({"grid": {"radio.load": []}}, "grid.radio.load: needs at least one value"),
    "no list": ({"grid": {"radio.load": 1}}, "grid.radio.load = 1: must be a list"),
    "twice": ({"grid": {"radio.load": [1]}, "zip": {"radio.load": [1]}}, "radio.load is swept twice"),
    "set": ({"grid": {"radio.load": [1]}, "set": {"radio.load": 0.5}}, "radio.load is swept, and set to 0.5"),
    "lengths": ({"zip": {"radio.load": [1], "radio.clutter_scale": [1, 2]}}, "radio.load has 1, radio.clutter_scale"),
    "list keys": ({"list": [{"radio.load": 1}, {"radio.cluter_scale": 1}]}, "unknown key 'radio.cluter_scale'"),
    "estimator": ({"grid": {"estimator.fastslam.particles": [1]}}, "'fastslam' is not among the estimators"),
    "range": ({"latin": {"points": 2, "ranges": {"radio.load": {"low": 1, "high": 0}}}}, "needs low < high"),
    "log": (
        {"latin": {"points": 2, "ranges": {"radio.load": {"low": 0, "high": 1, "scale": "log"}}}},
        "0 < low < high",
    ),
    "part": ({"gird": {}}, "unknown key 'gird'; did you mean 'grid'"),
    "trials": ({"trials": 0}, "trials = 0: must be at least 1"),
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
    file.write_text("scenario = ")
    with pytest.raises(InputError, match=r"s.toml: not a sweep file"):
        sweep.read(file)


def test_what_the_documentation_shows() -> None:
    text = (Path(__file__).parents[2] / "docs" / "how-to" / "sweep.md").read_text("utf-8")
    (block,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    shown = sweep.from_tables(tomllib.loads(block))
    assert len(sweep.points(shown, shown.estimators)) == 2 * 2 * 2 * 2 * 3
    commands = [line for part in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in part.split("\ncellslam ")]
    assert len(commands) == 3
    swept = 0
    for command in commands:
        arguments = build_parser().parse_args(shlex.split(command.removeprefix("cellslam ").replace("\\\n", " ")))
        if hasattr(arguments, "sweeps"):
            swept += 1
            estimators = arguments.estimators or DEFAULT_ESTIMATORS
            assert len(sweep.points(requested(arguments), estimators)) == 4
    assert swept >= 1
