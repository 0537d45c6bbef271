"""Names of estimators: built-in, `module:Class`, entry points of other packages, `all`; and broken plug-ins."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

from cellslam.cli.main import main
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.external_options import asking
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
BROKEN = """
def compute():
    return 1 / 0

compute()
"""
ENTRY_POINTS = """[cellslam.estimators]
mine=registry_good:Mine
fastslam=registry_bad:X
broken=registry_bad:X
empty=json:Nothing
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current directory with modules of estimators."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    (tmp_path / "registry_good.py").write_text(GOOD)
    (tmp_path / "registry_needs.py").write_text("import no_such_package_at_all\n")
    (tmp_path / "registry_bad.py").write_text(BROKEN)
    importlib.invalidate_caches()
    return tmp_path


@pytest.fixture
def plugins(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install them as a package with entry points, beside this environment."""
    info = folder / "other-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(folder))
    return folder


def test_a_class_is_called_what_itself_says(folder: Path) -> None:
    said = {"Own": "own", "Same": "mine", "Theirs": "fastslam", "Path": "a/b"}
    classes = [f"class {name}(Mine): name = {text!r}\n" for name, text in said.items()]
    (folder / "registry_names.py").write_text(GOOD + "".join(classes) + "class Derived(Mine): pass\n")
    targets = [f"registry_names:{name}" for name in ("Mine", "Own", "Theirs", "Derived", "Path")]
    names = ["mine", "own", *targets[2:]]
    for ask in (None, "asked"):
        if ask is None:
            assert [one.name for one in resolve({}, targets)] == names
        else:
            with asking() as answer:
                found = resolve({}, targets, ask=answer)
            assert [one.name for one in found] == names and [one.target for one in found] == targets
    with pytest.raises(InputError, match="registry_names:Mine and registry_names:Same are both called 'mine'"):
        resolve({}, ["registry_names:Mine", "registry_names:Same"])


def test_class_from_the_current_directory_which_hides_no_installed_package(folder: Path) -> None:
    assert registry.resolve("registry_good:Mine").name == "mine"
    assert sys.path.index(str(folder)) == len(sys.path) - 1
    assert registry.options_model(registry.resolve("registry_good:Mine")) is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fastslm", ["unknown estimator 'fastslm'", "did you mean 'fastslam'", "dead-reckoning", "module:Class"]),
        ("nowhere_at_all:X", ["no module 'nowhere_at_all'"]),
        ("registry_good:Mein", ["'Mein'", "did you mean 'Mine'"]),
        ("numpy:Foo", ["unknown class of module numpy 'Foo'"]),
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
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words)


def test_entry_points_do_not_replace_built_in_estimators(plugins: Path) -> None:
    listed = {entry.name: entry for entry in registry.listing()}
    assert listed["mine"].summary == "from the package other" and registry.resolve("mine").name == "mine"
    assert listed["fastslam"].target.startswith("cellslam.slam.fastslam")


def test_oracles_are_listed_as_what_their_classes_say() -> None:
    built_in = [entry.name for entry in registry.BUILT_IN if entry.name not in registry.left_out()]
    of_classes = {name for name in built_in if registry.resolve(name).requires_truth}
    assert {entry.name for entry in registry.BUILT_IN if entry.oracle} == of_classes
    assert of_classes == {"oracle-association", "oracle-fastslam", "oracle-map"}


def test_all_is_every_known_estimator_that_is_fast_enough(plugins: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(registry.expanded(["all"])) == set(registry.names()) - set(registry.left_out())
    assert registry.expanded(["ekf-slam", "all"])[0] == "ekf-slam"
    assert {"broken", "empty"} < set(registry.expanded(["all"]))
    monkeypatch.setattr(registry, "find_spec", lambda name: None)
    assert registry.left_out()["smoother"] == "needs gtsam: pip install 'cellslam[gtsam]'"
    assert "smoother" not in registry.expanded(["all"])
    slow = tuple(registry.Listed(e.name, e.target, e.summary, slow=e.name == "ekf-slam") for e in registry.BUILT_IN)
    monkeypatch.setattr(registry, "BUILT_IN", slow)
    assert registry.left_out() == {"ekf-slam": "slower than 5 x real time"}
    assert "ekf-slam" in registry.expanded(["ekf-slam", "all"])


def test_broken_plugins_are_failed_rows_and_disturb_nobody(plugins: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ("--estimator", "broken", "--estimator", "dead-reckoning", "--estimator", "empty")
    assert main(["run", "tiny", *names, "--json", "--no-figures", "--quiet"]) == 1
    rows = {row["estimator"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["dead-reckoning"]["status"] == "ok"
    assert rows["broken"]["status"] == rows["empty"]["status"] == "failed"
    assert "ZeroDivisionError: division by zero" in rows["broken"]["error"]
    assert "(registry_bad.py, line 3, in compute)" in rows["broken"]["error"]
    assert "unknown class of module json" in rows["empty"]["error"]
    assert "in compute" in (plugins / "results" / "tiny-0" / "error-broken.txt").read_text("utf-8")
