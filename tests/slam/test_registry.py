from __future__ import annotations

import importlib
import importlib.metadata
import sys
from pathlib import Path

import pytest

from cellslam.sim.errors import InputError
from cellslam.slam import registry

GOOD = """
class Mine:
    name = "mine"
    def __init__(self, options): self.options = options
    def start(self, setup, rng): pass
    def step(self, dt_s, odometry, snapshot): pass

class Idle: pass

function = len
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    (tmp_path / "registry_good.py").write_text(GOOD)
    (tmp_path / "registry_needs.py").write_text("import no_such_package_at_all\n")
    (tmp_path / "registry_bad.py").write_text("1 / 0\n")
    importlib.invalidate_caches()
    return tmp_path


def test_class_from_the_current_directory(folder: Path) -> None:
    assert registry.resolve("registry_good:Mine").name == "mine"
    assert sys.path[-1] == str(folder)
    assert registry.options_model(registry.resolve("registry_good:Mine")) is None


def test_current_directory_does_not_hide_installed_packages(folder: Path) -> None:
    (folder / "json").mkdir()
    (folder / "json" / "__init__.py").write_text("1 / 0\n")
    registry.resolve("registry_good:Mine")
    assert sys.path.index(str(folder)) == len(sys.path) - 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "fastslm",
            ["unknown estimator 'fastslm'", "did you mean 'fastslam'", "dead-reckoning", "module:Class"],
        ),
        ("nowhere_at_all:X", ["no module 'nowhere_at_all'"]),
        ("registry_good:Mein", ["'Mein'", "did you mean 'Mine'"]),
        ("numpy:Foo", ["unknown class of module numpy 'Foo' (known: none)"]),
        ("registry_good:Idle", ["no method 'start'"]),
        ("registry_good:function", ["no method 'start'"]),
        ("registry_needs:X", ["cannot be imported", "no_such_package_at_all"]),
        ("registry_bad:X", ["cannot be imported", "ZeroDivisionError: division by zero"]),
        (":", ["estimator ':'"]),
        ("registry_good:", ["'registry_good:'"]),
        ("", ["unknown estimator ''"]),
    ],
)
def test_what_cannot_be_resolved(folder: Path, name: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        registry.resolve(name)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_entry_points_of_other_packages(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = folder / "other-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[cellslam.estimators]\nmine=registry_good:Mine\nfastslam=registry_bad:X\nbroken=registry_bad:X\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    listed = {entry.name: entry for entry in registry.listing()}
    assert listed["mine"].summary == "from the package other"
    assert listed["fastslam"].target.startswith("cellslam.slam.fastslam")
    assert registry.resolve("mine").name == "mine"
    with pytest.raises(InputError, match="'broken': its module cannot be imported"):
        registry.resolve("broken")


def test_oracles_are_listed_as_what_their_classes_say() -> None:
    built_in = [entry.name for entry in registry.BUILT_IN if entry.name not in registry.left_out()]
    of_classes = {name for name in built_in if registry.resolve(name).requires_truth}
    assert registry.oracles([*built_in, "registry_bad:Unknown"]) == of_classes
    assert len(of_classes) == 3
