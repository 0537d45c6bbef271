"""The package as a user gets it: built, installed in an empty environment, run from an empty directory."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LEFT_OUT = (".git", ".venv", "build", "dist", "results")


def run(*words: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(word) for word in words], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def left_out(at: str, names: list[str]) -> set[str]:
    return {name for name in names if name == "__pycache__" or (Path(at) == ROOT and name in LEFT_OUT)}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy: a build leaves folders in its source."""
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, folder / "source", symlinks=True, ignore=left_out)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps", "--no-build-isolation")
    run(*pip, "--wheel-dir", folder, folder / "source", cwd=folder)
    (built,) = folder.glob("cellslam-*.whl")
    return built


@pytest.mark.slow
def test_wheel_holds_every_module_preset_and_type_marker(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    rooms = ("sim", "slam", "scenarios", "benchmarks")
    wanted = {
        f"cellslam/{path.relative_to(ROOT)}"
        for room in rooms
        for pattern in ("*.py", "*.toml")
        for path in (ROOT / room).rglob(pattern)
    }
    assert (wanted | {"cellslam/py.typed"}) - held == set()
    assert not [name for name in held if name.split("/")[0] in (*rooms, "tests", "docs")]


@pytest.mark.slow
def test_installed_wheel_runs_from_an_empty_directory(wheel: Path, tmp_path: Path) -> None:
    home, empty = tmp_path / "environment", tmp_path / "empty"
    venv.create(home, with_pip=False)
    empty.mkdir()
    python = home / "bin" / "python"
    run(
        *(sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python),
        *("install", "--no-deps", "--no-index", wheel),
        cwd=empty,
    )
    own = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=empty).strip())
    # The dependencies are those of this environment; its own cellslam comes later on the path.
    (own / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    origin = run(python, "-c", "import cellslam.benchmarks as b; print(b.__file__)", cwd=empty)
    assert Path(origin.strip()).is_relative_to(home)
    command = home / "bin" / "cellslam"
    # No kernel of this installation is compiled yet: what needs none, and reads the package's own files.
    assert run(command, "show", "lund-530", cwd=empty).startswith("lund-530: ")
    check = "import cellslam; from cellslam.sim.lte.statistical.statistics import statistics; statistics()"
    run(python, "-c", f"{check}; print(cellslam.__version__, cellslam.load('canyon'))", cwd=empty)
    assert "\n lund-530 " in run(command, "list", "scenarios", cwd=empty)
    assert not list(empty.iterdir())


def test_source_distribution_holds_what_the_tests_need(tmp_path: Path) -> None:
    shutil.copytree(ROOT, tmp_path / "source", ignore=left_out)
    build = "from setuptools import build_meta; build_meta.build_sdist('..')"
    run(sys.executable, "-c", build, cwd=tmp_path / "source")
    (built,) = tmp_path.glob("cellslam-*.tar.gz")
    with tarfile.open(built) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    for folder in ("tests", "docs", "packaging"):
        needed = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*") if path.is_file()}
        assert {name for name in needed - held if "__pycache__" not in name} == set()
    assert {".zenodo.json", ".ci/run", "CITATION.cff", "CONTRIBUTING.md", "CHANGELOG.md"} <= held
