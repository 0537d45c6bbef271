from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("sim", "slam", "scenarios", "benchmarks")
TOP = ("recordings", "python_api", "cli")  # of the package itself, in the order in which they stand on each other
# Of sim, estimators see the data contract and the frames; the others are helpers without a model.
OPEN_TO_SLAM = ("recording", "frames", "errors", "progress", "randomness", "described", "compiling")


def imported(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and dotted name of every import, those inside functions and for type checking included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)


def offences(room: str, source: str) -> list[str]:
    """Return the imports of `source`, a module of `room`, that run against the direction of the rooms."""
    out = []
    for line, name in imported(ast.parse(source)):
        parts = name.split(".")
        if parts[0] in ROOMS or name.startswith("."):
            out.append(f"line {line}: {name} is not imported from cellslam")
        if parts[0] != "cellslam" or len(parts) < 2:
            continue
        target, order = parts[1], (*ROOMS, *TOP)
        if order.index(target) > order.index(room):
            out.append(f"line {line}: {room} imports {name}")
        elif room == "slam" and target == "sim" and parts[2] not in OPEN_TO_SLAM:
            out.append(f"line {line}: slam imports {name}")
    return out


@pytest.mark.parametrize("room", (*ROOMS, *TOP))
def test_imports_run_one_way(room: str) -> None:
    place = ROOT / room if room in ROOMS else ROOT / "cellslam" / room
    modules = list(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    # What `cellslam.benchmarks` offers of the Python API is loaded when it is asked for.
    modules = [module for module in modules if module != ROOT / "benchmarks" / "__init__.py"]
    assert modules
    found = {str(m.relative_to(ROOT)): offences(room, m.read_text("utf-8")) for m in modules}
    assert {name: wrong for name, wrong in found.items() if wrong} == {}


@pytest.mark.parametrize(
    ("room", "source"),
    [
        ("sim", "from cellslam.slam.api import Setup"),
        ("sim", "def f():\n    import cellslam.cli.main"),
        ("slam", "from cellslam.sim.world import simulate"),
        ("slam", "from cellslam.sim import lte"),
        ("slam", "import cellslam.scenarios"),
        ("scenarios", "from cellslam.benchmarks import run"),
        ("benchmarks", "from cellslam.recordings import Campaign"),
        ("recordings", "from cellslam.cli import main"),
        ("benchmarks", "import sim"),
        ("benchmarks", "from .table import results_table"),
    ],
)
def test_the_check_finds_what_it_is_for(room: str, source: str) -> None:
    assert offences(room, source)


def test_the_check_lets_the_rest_pass() -> None:
    assert not offences("slam", "from cellslam.sim.recording import Recording\nimport numpy.random")
    assert not offences("scenarios", "from cellslam.sim.world import WorldConfig\nimport cellslam.slam.registry")
    assert not offences("benchmarks", "from cellslam.scenarios import load\nfrom cellslam.sim import simulate")


def loaded_after(code: str) -> set[str]:
    script = f"{code}\nimport sys\nprint(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_help_loads_nothing_heavy() -> None:
    loaded = loaded_after("from cellslam.cli.main import build_parser\nbuild_parser([]).format_help()")
    assert not loaded & {"numpy", "pydantic", "rich", "pandas", "numba", "matplotlib", "h5py"}


def test_reading_a_scenario_compiles_nothing() -> None:
    loaded = loaded_after("import cellslam.scenarios.scenario, cellslam.slam.registry")
    assert "pydantic" in loaded
    assert not loaded & {
        "numba",
        "scipy",
        "trimesh",
        "shapely",
        "matplotlib",
        "highway_env",
        "pandas",
        "h5py",
    }


def test_windows_is_told_in_one_line_what_to_do() -> None:
    words = [sys.executable, "-c", "import sys; sys.platform = 'win32'; import cellslam"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stderr.splitlines()[-1].startswith("ImportError: cellslam runs on Linux")
