"""The packages: who imports whom, without circles; what an import loads; the picture of them."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
# Each package imports from those before it alone; the last three stand in cellslam/ itself.
ORDER = ("sim", "slam", "scenarios", "benchmarks", "recordings", "python_api", "cli")
PACKAGES = ORDER[:4]
# Of sim, estimators see the data contract and the frames; the others are helpers without a model.
OPEN_TO_SLAM = (
    "recording",
    "frames",
    "errors",
    "progress",
    "randomness",
    "described",
    "compiling",
    "plausible",
    "data_files",
    "own_code",
)


def picture() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_architecture", ROOT / "docs" / "draw_architecture.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PICTURE = picture()


def modules() -> dict[str, Path]:
    """Return all modules of the package by dotted name."""
    found = {}
    for package in (*PACKAGES, "cellslam"):
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            found[name if package == "cellslam" else f"cellslam.{name}"] = path
    return found


def imported(source: str) -> set[str]:
    """Return the dotted names that are imported, those inside functions and for type checking included."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names}
    return found


def offences(package: str, source: str) -> list[str]:
    """Return the imports of `source`, a module of `package`, that run against the order of the packages."""
    out = []
    for name in imported(source):
        top, target, part = [*name.split("."), "", ""][:3]
        if top in PACKAGES or name.startswith("."):
            out.append(f"{name} is not imported from cellslam")
        elif top == "cellslam" and target in ORDER:
            against = ORDER.index(target) > ORDER.index(package)
            if against or (package == "slam" and target == "sim" and part not in OPEN_TO_SLAM):
                out.append(f"{package} imports {name}")
    return out


def test_imports_run_one_way() -> None:
    # What `cellslam.benchmarks` offers of the Python API is loaded when it is asked for.
    known = {name: path for name, path in modules().items() if name not in ("cellslam", "cellslam.benchmarks")}
    package = {name: name.split(".")[1] for name in known}
    found = {n: offences(package[n], path.read_text("utf-8")) for n, path in known.items() if package[n] in ORDER}
    assert set(ORDER) <= set(package.values())
    assert {name: wrong for name, wrong in found.items() if wrong} == {}


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("sim", "def f():\n    import cellslam.cli.main"),
        ("slam", "from cellslam.sim import lte"),
        ("recordings", "from cellslam.cli import main"),
        ("benchmarks", "import sim"),
        ("benchmarks", "from .table import results_table"),
    ],
)
def test_an_import_against_the_order_is_noticed(package: str, source: str) -> None:
    assert offences(package, source)
    assert not offences("slam", "from cellslam.sim.recording import Recording\nimport numpy.random")


def test_no_module_imports_in_a_circle() -> None:
    known = modules()
    graph = {}
    for name, path in known.items():
        wanted = {other if other in known else other.rpartition(".")[0] for other in imported(path.read_text("utf-8"))}
        graph[name] = (wanted & known.keys()) - {name}
    assert len(graph) > 300
    TopologicalSorter(graph).prepare()  # raises where there is a circle


@pytest.mark.parametrize("layer", PICTURE.LAYERS)
def test_no_package_imports_in_a_circle(layer: str) -> None:
    graph = PICTURE.inside(layer, PICTURE.uses())
    assert len(graph) > 1
    TopologicalSorter(graph).prepare()


def test_picture_is_of_the_code_as_it_is() -> None:
    assert PICTURE.PICTURE.read_text("utf-8") == PICTURE.drawn(), "run python docs/draw_architecture.py"


def test_no_module_is_left_out_of_type_checking() -> None:
    mypy = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["mypy"]
    assert mypy["strict"]
    assert [name for table in mypy["overrides"] for name in table["module"] if name.startswith("cellslam")] == []


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import cellslam; dir(cellslam)", "numpy pydantic pandas numba scipy h5py"),
        ("import cellslam.cli.main as c; c.build_parser([]).format_help()", "numpy pydantic rich pandas numba h5py"),
        ("import cellslam.scenarios.scenario, cellslam.slam.registry", "numba scipy trimesh shapely matplotlib pandas"),
    ],
)
def test_nothing_heavy_is_loaded(code: str, heavy: str) -> None:
    """Also where a checkout, with its folders sim and slam, is the working directory."""
    words = [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"]
    loaded = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert "cellslam" in loaded and not set(loaded) & set(heavy.split())


def test_windows_is_told_in_one_line_what_to_do() -> None:
    words = [sys.executable, "-c", "import sys; sys.platform = 'win32'; import cellslam"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stderr.splitlines()[-1].startswith("ImportError: cellslam runs on Linux")
