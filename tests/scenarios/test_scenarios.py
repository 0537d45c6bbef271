from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from cellslam.scenarios import overrides
from cellslam.scenarios.estimator_options import resolve, with_options
from cellslam.scenarios.loading import load
from cellslam.sim.errors import InputError

PLACE = """
title = "A place"
[city]
kind = "procedural"
seed = 3
[[sites]]
name = "A"
cells = [{ cell_id = 375 }]
[radio]
load = 0.2
[estimator.fastslam]
particles = 50
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    path = tmp_path / "place.toml"
    path.write_text(PLACE)
    return path


def failure(path: Path | str, *sets: str) -> str:
    with pytest.raises(InputError) as caught:
        load(path, overrides.parse_all(sets))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_file_and_overrides(place: Path) -> None:
    scenario = load(place, overrides.parse_all(["radio.load=0.5", "sites.A.ports=1", "sites.0.cells.0.cell_id=2"]))
    assert (scenario.name, scenario.title) == ("place", "A place")
    assert scenario.radio.load == 0.5
    assert scenario.sites[0].ports == 1
    assert scenario.sites[0].cells[0].cell_id == 2
    assert load(place).radio.load == 0.2


def test_resolved_toml_gives_the_same_scenario(place: Path, tmp_path: Path) -> None:
    scenario = load(place, {"vehicle.waypoints_m": [[0, 1], [2, 3.5]], "estimator.fastslam.gate": 11.3})
    again = tmp_path / "scenario.toml"
    again.write_text(scenario.toml())
    assert load(again).resolved == scenario.resolved
    assert load(again).world == scenario.world


def test_override_is_a_key_and_a_toml_value_or_a_bare_word() -> None:
    values = {
        "1": 1, "1.5": 1.5, "true": True, "word": "word", "'1'": "1", " x ": "x", "[1, 2]": [1, 2], "2-ring": "2-ring",
        "": "", "x=y": "x=y",
    }  # fmt: skip
    for text, value in values.items():
        assert overrides.parse(f"a.b ={text}") == ("a.b", value)
    for text in ("radio.load", "=3", ".load=3", "radio..load=3", ""):
        with pytest.raises(InputError, match="write KEY=VALUE"):
            overrides.parse(text)
    assert overrides.parse_all(["a=1", "a=1"]) == {"a": 1}
    with pytest.raises(InputError, match="given twice"):
        overrides.parse_all(["a=1", "a=2"])
    assert overrides.split("estimator.a.b:C.gain") == ["estimator", "a.b:C", "gain"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("radio.laod=0.3", ["unknown key 'radio.laod'", "did you mean 'radio.load'"]),
        ("detection_scale=0.3", ["did you mean 'radio.detection_scale'"]),
        ("sites.A.prts=3", ["unknown key 'sites.A.prts'", "did you mean 'sites.A.ports'"]),
        ("sites.B.ports=3", ["no 'sites.B'", "known: A"]),
        ("radio.load=3", ["radio.load = 3", "0 to 1", "share of other cells"]),
        ("radio.load='0.5'", ["radio.load = '0.5'", "a number"]),
        ("radio.load=true", ["radio.load", "a number"]),
        ("radio.load.x=1", ["radio.load is a single value"]),
        ("radio.front_end=magic", ["radio.front_end = 'magic'", "'statistical'"]),
        ("radio.perfect_detection=1", ["must be true or false"]),
        ("city.height_min_m=100", ["city: height_max_m 35.0 is below height_min_m 100"]),
        ("vehicle.waypoints_m=[[1, 2], [3]]", ["'vehicle.waypoints_m.1.1' is missing"]),
        ("estimator.particles=5", ["name the estimator", "estimator.fastslam.particles"]),
    ],
)
def test_wrong_override_says_what_is_allowed(place: Path, text: str, words: list[str]) -> None:
    message = failure(place, text)
    for word in words:
        assert word in message


def test_wrong_files(tmp_path: Path) -> None:
    path = tmp_path / "drive.toml"
    assert "unknown scenario 'tinny'; did you mean 'tiny'?" in failure("tinny")
    assert "drive.toml: no such scenario file" in failure(path)
    path.write_text("a = ")
    assert "drive.toml: not a scenario file" in failure(path)
    path.write_bytes(b"\xff\xfe\x00")
    assert "no UTF-8" in failure(path)
    path.write_text(PLACE.replace("[city]", "[cty]"))
    assert "drive.toml: unknown key 'cty.kind'; did you mean 'city.kind'?" in failure(path)


def test_a_file_has_what_it_changes_of_its_base(place: Path, tmp_path: Path) -> None:
    changed = tmp_path / "changed.toml"
    changed.write_text('base = "place.toml"\n[radio]\nevm = 0.1\n[sites.A]\nports = 1\n[estimator."a.b:C"]\ngain = 2\n')
    one, other = load(place), load(changed)
    assert (other.name, other.title) == ("changed", "")
    assert (other.city, other.radio.load, other.radio.evm) == (one.city, 0.2, 0.1)
    assert (other.sites[0].ports, other.sites[0].cells) == (1, one.sites[0].cells)
    assert other.estimator == {"fastslam": {"particles": 50}, "a.b:C": {"gain": 2}}
    changed.write_text('base = "tiny"\n')
    assert load(changed).world == load("tiny").world
    assert not load(changed).facts


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ('"tinny"', "tinny: no such scenario file; presets are"),
        ("3", "changed.toml: base = 3: must be a preset's name"),
        ('"../places/changed.toml"', "changed.toml: base = '../places/changed.toml': the file is its own base"),
        ('"tiny"\nsites.C.ports = 1', "changed.toml: there is no 'sites.C' (known: A, B)"),
        ('"tiny"\ncity.sed = 1', "changed.toml: unknown key 'city.sed'; did you mean 'city.seed'?"),
    ],
)
def test_a_wrong_base_says_what_is_wrong(tmp_path: Path, base: str, words: str) -> None:
    path = tmp_path / "places" / "changed.toml"
    path.parent.mkdir()
    path.write_text(f"base = {base}\n")
    assert words in failure(path)


def test_a_file_is_looked_for_beside_the_scenario_and_then_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> str:
        scenario = load("places/place.toml")
        assert scenario.estimator["ekf-slam"]["calibration_file"] == scenario.city.path  # type: ignore[union-attr]
        return str(scenario.city.path)  # type: ignore[union-attr]

    (tmp_path / "places").mkdir()
    named = '[estimator.ekf-slam]\ncalibration_file = "town.ply"\n'
    city = PLACE.replace('kind = "procedural"\nseed = 3', 'kind = "mesh"\npath = "town.ply"')
    (tmp_path / "places" / "place.toml").write_text(city + named)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "town.ply").touch()
    assert found() == "town.ply"
    (tmp_path / "places" / "town.ply").touch()
    assert found() == "places/town.ply"
    assert load("places/place.toml", {"city.path": "town.ply"}).city.path == "town.ply"  # type: ignore[union-attr]


def test_options_are_validated_by_the_estimators_own_model(place: Path) -> None:
    scenario = load(place)
    (request,) = resolve(scenario.estimator, ["fastslam", "fastslam"])
    assert request.options is not None
    assert request.options.model_dump()["particles"] == 50
    full = with_options(scenario, [request])
    assert full.resolved["estimator"]["fastslam"]["gate"] > 0
    assert tomllib.loads(full.toml())["estimator"]["fastslam"]["particles"] == 50


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("estimator.fastslam.particles=0", ["estimator.fastslam.particles = 0", "1 to"]),
        ("estimator.fastslam.partcles=9", ["did you mean 'estimator.fastslam.particles'"]),
        ("estimator.fastslm.particles=9", ["unknown table 'estimator.fastslm'", "'estimator.fastslam'"]),
        ("estimator.dead-reckoning.gain=9", ["'estimator.dead-reckoning.gain'", "no options"]),
    ],
)
def test_wrong_options(place: Path, text: str, words: list[str]) -> None:
    sets = overrides.parse_all([text])
    scenario = load(place, sets)
    with pytest.raises(InputError) as caught:
        resolve(scenario.estimator, ["dead-reckoning"], sets)
    for word in words:
        assert word in str(caught.value)
