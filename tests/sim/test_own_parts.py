"""Parts of the world of a user's own: antenna pattern, path loss, constants of the detector; the documentation's."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import cellslam
from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.sweeps.tasks import world_json
from cellslam.benchmarks.trials.failures import explained
from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.statistical.statistics import file_of
from cellslam.sim.world import prepare
from tests.short_drive import SET

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "replace-parts-of-the-world.md"


def cut(width_deg: float) -> str:
    """A cut of a data sheet: 12 (a / width)^2 dB, 25 at the most."""
    angle = (np.arange(360) + 180) % 360 - 180
    return "\n".join(f"{a}.0 {min(12.0 * (x / width_deg) ** 2, 25.0):.2f}" for a, x in enumerate(angle))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in a folder with the documentation's module, a data sheet and a module of mistakes."""
    (tmp_path / "my_world.py").write_text(PAGE.read_text().split("```python\n")[1].split("```")[0])
    (tmp_path / "sector.msi").write_text(
        f"NAME a\nGAIN 15 dBi\nHORIZONTAL 360\n{cut(65.0)}\nVERTICAL 360\n{cut(8.0)}\n"
    )
    (tmp_path / "wrong.py").write_text("def one(*given): return 1.0\ndef bad(*given): return given.nothing\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place])
    monkeypatch.setattr("cellslam.sim.own_code._LOADED", {})
    for name in ("my_world", "wrong"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_sector_antenna() -> None:
    gain_db = RadioConfig().sector_gain_db
    assert gain_db(0.0, -np.radians(8.0), np.radians(8.0)) == pytest.approx(0.0)
    # 3 dB down at half the width, either way; never more than 25 dB below the peak, behind or anywhere.
    assert gain_db(np.radians(35.0), -np.radians(8.0), np.radians(8.0)) == pytest.approx(-3.0)
    assert gain_db(0.0, -np.radians(13.0), np.radians(8.0)) == pytest.approx(-3.0)
    assert gain_db(np.pi, 1.0, 0.1) == pytest.approx(-25.0)
    assert gain_db(np.radians(190.0), 0.0, 0.0) == gain_db(np.radians(-170.0), 0.0, 0.0)


def test_patterns_have_their_greatest_gain_along_the_tilted_boresight() -> None:
    for name in ("3gpp", "my_world:cosine_pattern", "my_world:data_sheet"):
        radio, tilt = RadioConfig(antenna_pattern=name), np.radians(8.0)
        assert radio.sector_gain_db(0.0, -tilt, tilt) == pytest.approx(0.0)
        assert radio.sector_gain_db(np.radians([60.0, -60.0, 180.0]), -tilt, tilt).max() < -5.0
    sheet = RadioConfig(antenna_pattern="my_world:data_sheet")
    assert sheet.sector_gain_db(np.radians(65.0), 0.0, 0.0) == pytest.approx(-12.0)
    assert sheet.sector_gain_db(0.0, np.radians(-12.0), np.radians(8.0)) == pytest.approx(-3.0)


def test_a_path_loss_replaces_that_of_free_space() -> None:
    length, order = np.array([20.0, 200.0, 200.0]), np.array([0, 0, 1])
    factor = RadioConfig(path_loss="my_world:log_distance").path_gain_factor(length, order)
    assert factor is not None
    # Ten times as far: 32 dB in place of 20, and 3 dB more for the reflection.
    np.testing.assert_allclose(20.0 * np.log10(factor), [0.0, -12.0, -15.0], atol=1e-9)
    assert RadioConfig().path_gain_factor(length, order) is None


@pytest.mark.parametrize("key", ["radio.path_loss", "radio.antenna_pattern"])
def test_what_a_part_returns_and_raises_is_said_with_its_key(key: str) -> None:
    with pytest.raises(InputError, match=rf"{key}: wrong:one returned an array of shape \(\), where numbers of shape"):
        cellslam.simulate("tiny", overrides={**SET, key: "wrong:one"})
    with pytest.raises(AttributeError) as caught:
        cellslam.simulate("tiny", overrides={**SET, key: "wrong:bad"})
    assert f"in the {key} wrong:bad" in explained(caught.value)
    assert explained(caught.value).endswith("(wrong.py, line 2, in bad)")
    with pytest.raises(InputError, match=f"{key} 'nowhere:at' cannot be loaded"):
        cellslam.simulate("tiny", overrides={**SET, key: "nowhere:at"})


def test_own_parts_decide_what_is_received_and_the_default_keeps_its_name() -> None:
    plain = cellslam.simulate("tiny", overrides=SET)
    for key, name in (("antenna_pattern", "my_world:cosine_pattern"), ("path_loss", "my_world:log_distance")):
        own = cellslam.simulate("tiny", overrides={**SET, f"radio.{key}": name})
        assert own.measurements.snr_db.mean() != pytest.approx(plain.measurements.snr_db.mean(), abs=0.05)
        assert own.provenance["world"]["radio"][key] == name
        assert key not in plain.provenance["world"]["radio"]


def test_what_a_recording_names_is_not_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    odd = cellslam.simulate("tiny", overrides={**SET, "radio.path_loss": "my_world:log_distance"})
    assert Origin.of(odd).scenario is not None  # as this process was asked for it
    monkeypatch.setattr("cellslam.sim.own_code._LOADED", {})
    assert Origin.of(odd).scenario is None


def test_constants_of_the_detector_come_from_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    constants = json.loads(file_of().read_text())
    constants["detection"]["gain"] = 1e-6
    Path("deaf.json").write_text(json.dumps(constants))
    deaf = cellslam.simulate("tiny", overrides={**SET, "radio.statistics_file": "deaf.json"})
    plain = cellslam.simulate("tiny", overrides=SET)
    assert deaf.truth is not None and plain.truth is not None
    assert (deaf.truth.measurement_vt >= 0).sum() < 0.5 * (plain.truth.measurement_vt >= 0).sum()
    assert bound(deaf).position_rmse_m > bound(plain).position_rmse_m
    monkeypatch.setattr("cellslam.sim.own_code._READ", set())
    assert Origin.of(deaf).scenario is None and Origin.of(deaf).code == {"radio.statistics_file": "deaf.json"}
    with pytest.raises(InputError, match="not read unasked"):
        bound(deaf)
    for text, message in (("{}", "not constants of a detector"), ("[", "not constants"), ("[]", "not constants")):
        Path("deaf.json").write_text(text)
        with pytest.raises(InputError, match=message):
            cellslam.simulate("tiny", overrides={**SET, "radio.statistics_file": "deaf.json"})
    with pytest.raises(InputError, match="cannot be read"):
        cellslam.simulate("tiny", overrides={**SET, "radio.statistics_file": "nowhere.json"})


def test_another_content_of_the_file_of_constants_is_another_scenario() -> None:
    file, overrides = Path("mine.json"), {**SET, "radio.statistics_file": "mine.json"}
    file.write_text(file_of().read_text())
    first, recording = cellslam.load("tiny", overrides), cellslam.simulate("tiny", overrides=overrides)
    assert world_json(cellslam.load("tiny", overrides)) == world_json(first)
    file.write_text(file_of().read_text() + " ")
    assert world_json(cellslam.load("tiny", overrides)) != world_json(first)
    for again in (
        lambda: from_tables(first.resolved),
        lambda: cellslam.simulate(first, trial=1),
        lambda: bound(recording),
    ):
        with pytest.raises(InputError, match=r"has another content \(\w+\) than when the scenario was stored"):
            again()
    taken = from_tables(first.resolved, {"radio.statistics_digest": ""})
    assert taken.world == cellslam.load("tiny", overrides).world
    file.unlink()  # what a recording names is not opened
    origin = Origin.of(recording)
    assert origin.scenario is not None and origin.scenario.world == first.world


def test_both_front_ends_ask_for_the_pattern() -> None:
    for front_end in ("statistical", "signal"):
        overrides = {**SET, "radio.front_end": front_end, "radio.antenna_pattern": "wrong:bad"}
        world = prepare(cellslam.load("tiny", overrides).world, 0, 0)
        with pytest.raises(AttributeError, match="nothing"):
            world.measure(world.drive.poses[:1], world.drive.velocity[:1], 0, world.streams())
