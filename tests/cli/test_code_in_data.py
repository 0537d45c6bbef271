"""Files from elsewhere that name code: it runs only where the user asks for it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from tests.command_line import Run, refused
from tests.short_drive import SHORT

EVIL = """
from pathlib import Path
from cellslam.slam.fastslam.parts import BUILT_IN
Path("ran").touch()
class W: pass
part = BUILT_IN["association"]["nearest-neighbour"]
"""
WORLD = """
[city]
kind = "procedural"
[[sites]]
name = "A"
cells = [{ cell_id = 1 }]
[vehicle]
route = 1
distance_m = 40.0
duration_s = 60.0
stops = 1
"""
REPLAY = ("replay", "drive.h5", "--estimator", "dead-reckoning", "--estimator", "fastslam", "--no-figures", "--quiet")


@pytest.fixture
def ran(cellslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], bool]:
    """Whether `evil`, a module that Python would find, was imported."""
    (tmp_path / "evil.py").write_text(EVIL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("cellslam.sim.lte.radio_config._LOADED", {})
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    return lambda: (tmp_path / "ran").exists()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    from cellslam.cli.main import main

    path = tmp_path_factory.mktemp("recorded") / "drive.h5"
    assert main(["--quiet", "record", "tiny", *SHORT, "--out", str(path)]) == 0
    return Recording.load(path)


def renamed(recording: Recording, radio: dict[str, Any], fastslam: dict[str, Any]) -> Recording:
    """Return a recording whose provenance says something else."""
    said = json.loads(json.dumps(dict(recording.provenance)))
    for tables in (said["scenario"], said["world"]):
        tables["radio"] |= radio
    said["scenario"]["estimator"]["fastslam"] = fastslam
    return replace(recording, provenance=said)


@pytest.mark.parametrize(
    ("key", "value", "radio", "fastslam"),
    [
        ("radio.technology", "evil:W", {"technology": "evil:W", "front_end": "signal"}, {}),
        ("estimator.fastslam.association", "evil:part", {}, {"association": "evil:part"}),
    ],
)
def test_a_recording_is_data(
    key: str, value: str, radio: Any, fastslam: Any, recorded: Recording, ran: Callable[[], bool], cellslam: Run
) -> None:
    odd = renamed(recorded, radio, fastslam)
    odd.save("drive.h5")
    refused(cellslam(*REPLAY), f"names code, {key} = '{value}'", f"--set {key}={value}")
    cellslam("fit-noise", "drive.h5", "--quiet")
    cellslam("inspect", "drive.h5", "--no-figure", "--quiet")
    if radio:
        with pytest.raises(InputError, match=r"names code, radio\.technology"):
            bound(odd)
        refused(cellslam(*REPLAY, "--set", f"{key}=lte"), "a recording is as it is, with 'evil:W'")
    assert not ran()
    cellslam(*REPLAY, "--set", f"{key}={value}")
    assert ran()


def test_to_show_a_scenario_runs_nothing(ran: Callable[[], bool], cellslam: Run) -> None:
    own = '[estimator."evil:W"]\ngain = 3\n[estimator.fastslam]\nassociation = "evil:part"\n'
    Path("place.toml").write_text(f'{WORLD}[radio]\ntechnology = "evil:W"\nfront_end = "signal"\n{own}')
    done = cellslam("show", "place.toml")
    assert done.status == 0 and not ran()
    assert "evil:part" in done.out and "gain" not in done.out
    assert "not loaded, as it is code: radio.technology, estimator.fastslam.association, estimator.evil:W" in done.err
    assert str(Path.cwd()) not in sys.path[1:]
    Path("place.toml").write_text(WORLD + own)
    done = cellslam("show", "place.toml", "--load", "--quiet")
    assert done.status == 0 and ran(), done.err
