"""Compiled kernels after an edit of what they call: the new number, from a cache that knows its sources."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import pytest

from cellslam.sim import compiling

ROOT = Path(__file__).parents[2]
KERNEL = """
from cellslam.sim.compiling import njit
from cellslam.sim.frames.frames_kernel import wrap
@njit(cache=True)
def wrapped(angle):
    return wrap(angle)
"""
CALL = """
from cellslam.sim import wrapping_kernel as k
print(k.wrapped(4.0), sum(k.wrapped.stats.cache_hits.values()), k.__file__)
"""


def copy_of_sim(home: Path) -> Path:
    """Return a copy of the package's floor `sim` with a kernel that calls a function of another file."""
    shutil.copytree(ROOT / "sim", home / "sim", ignore=shutil.ignore_patterns("__pycache__"))
    (home / "sim" / "wrapping_kernel.py").write_text(KERNEL)
    shutil.copy(ROOT / "cellslam" / "__init__.py", home)
    return home


@pytest.fixture
def package(tmp_path: Path) -> Path:
    return copy_of_sim(tmp_path / "one" / "cellslam")


def called(package: Path) -> tuple[float, int]:
    """Return the number that a kernel of the copy gives in a process of its own, and how often the cache had it."""
    cache = package.parents[1] / "cache"
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": str(cache)}
    words = [sys.executable, "-c", CALL]
    done = subprocess.run(words, env=environment, cwd=package.parent, capture_output=True, text=True, check=True)
    number, hits, file = done.stdout.split()
    assert Path(file).is_relative_to(package)
    return float(number), int(hits)


@pytest.mark.slow
def test_a_copy_finds_what_was_compiled_and_an_edit_of_a_callee_is_noticed(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "_base", lambda: tmp_path / "cache" / "kernels")
    kernel, name = package / "sim" / "wrapping_kernel.py", "cellslam.sim.wrapping_kernel"
    assert not compiling.is_compiled(name, kernel)
    before, hits = called(package)
    assert (before, hits) == (pytest.approx(4.0 - 2.0 * 3.141592653589793), 0)
    assert called(package) == (before, 1) and compiling.is_compiled(name, kernel)
    other = copy_of_sim(tmp_path / "two" / "cellslam")
    os.utime(other / "sim" / "wrapping_kernel.py", ns=(1, 1))
    assert called(other) == (before, 1)
    assert not list(package.rglob("*.nbi"))  # nothing is left beside the sources
    callee = package / "sim" / "frames" / "frames_kernel.py"
    text = callee.read_text("utf-8")
    assert text.count("return rest - TURN") == 1
    callee.write_text(text.replace("return rest - TURN", "return 100.0 + rest - TURN"), "utf-8")
    compiling.cache_folder.cache_clear()
    compiling._read.cache_clear()
    assert not compiling.is_compiled(name, kernel)
    assert called(package) == (pytest.approx(100.0 + before), 0)


@pytest.mark.slow
def test_with_a_numba_that_nobody_knows_parts_are_plain_functions(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CELLSLAM_PLAIN_NJIT", "1")
    assert called(package)[0] == pytest.approx(4.0 - 2.0 * 3.141592653589793)


def test_old_folders_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "cellslam" / "sim"
    package.mkdir(parents=True)
    kernel = package / "one_kernel.py"
    made = []
    monkeypatch.setattr(compiling, "_base", lambda: tmp_path / "cache")
    for edit in range(compiling.KEPT + 3):
        kernel.write_text(f"edit = {edit}\n")
        os.utime(kernel, ns=(edit, edit))
        compiling.cache_folder.cache_clear()
        compiling._read.cache_clear()
        folder = compiling.cache_folder("cellslam.sim.one_kernel", kernel)
        folder.mkdir(parents=True)
        os.utime(folder, (edit, edit))
        made.append(folder)
    assert [folder.exists() for folder in made] == [False] * 2 + [True] * (compiling.KEPT + 1)


def test_where_no_folder_can_be_written_the_cache_is_of_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert compiling._base.__wrapped__() == tmp_path / "chosen" / "kernels"
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(compiling, "private_folder", lambda _: None)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = compiling._base.__wrapped__()
    assert folder.parent == tmp_path and folder.is_dir() and folder.name.startswith("cellslam-")


def test_a_plain_part_is_compiled_by_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "PLAIN", True)

    @compiling.lean
    def tripled(x: int) -> int:
        return 3 * x

    assert tripled(2) == 6 and len(tripled.signatures) == 1


@compiling.part
def doubled(x: int) -> int:
    return 2 * x


@compiling.part
def inverse(x: int) -> float:
    return 1.0 / x


@compiling.njit
def raised(x: int) -> float:
    return doubled(x) + doubled(1) + doubled(2) + inverse(x)


@pytest.mark.skipif(compiling.PLAIN, reason="parts are plain njit with this version of Numba")
def test_parts_are_as_python_and_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    assert raised(4) == 14.25 and doubled(4) == 8
    assert len(doubled._compiled.overloads) == 1  # not one for each constant
    with pytest.raises(ZeroDivisionError):
        raised(0)
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    assert compiling.part(doubled)(4) == 8


@compiling.part
def added(x: float) -> float:
    return (x + 1e16) - 1e16


@compiling.njit(fastmath=True)
def hasty(x: float) -> float:
    return added(x)


def test_a_part_does_not_depend_on_who_calls_it_first() -> None:
    assert hasty(1.0) == added(1.0) == 0.0


def test_lean_kernels_neither_return_arrays_nor_call_what_does() -> None:
    """References are not counted there: an array that is handed on would be freed too early, or never."""
    lean, arrays = dict[str, set[str]](), set[str]()
    for file in [file for room in ("joint", "model") for file in (ROOT / "slam" / room).rglob("*.py")]:
        for node in ast.parse(file.read_text("utf-8")).body:
            if not (isinstance(node, ast.FunctionDef) and node.decorator_list):
                continue
            returned = ast.unparse(node.returns or ast.Constant(""))
            if re.search(r"Floats|Ints|Filter|Block|Workspace|Jacobian|Rival", returned):
                arrays.add(node.name)
            if any("lean" in ast.unparse(one) for one in node.decorator_list):
                calls = [one.func for one in ast.walk(node) if isinstance(one, ast.Call)]
                lean[node.name] = {one.id for one in calls if isinstance(one, ast.Name)}
    assert len(lean) > 50 and {"one_of", "new_workspace"} <= arrays
    assert not arrays & lean.keys()
    assert not {name: found for name, calls in lean.items() if (found := calls & arrays)}
