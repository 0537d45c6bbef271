"""Run the tests with each supported Python, with the lowest and with the newest dependencies.

For each pair a clone of the checkout is installed in a fresh virtual environment by uv (`pip install uv`), which
resolves the lowest versions that pyproject.toml admits, and its fast tests run. A pair takes some ten minutes on two
cores.
"""

from __future__ import annotations

import subprocess
from argparse import ArgumentParser, Namespace
from itertools import product
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

from cellslam.cli.arguments import DONE
from cellslam.sim.errors import InputError

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.11", "3.12", "3.13")
RESOLUTIONS = {"lowest": "lowest-direct", "newest": "highest"}


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument(
        "--python",
        action="append",
        metavar="VERSION",
        help=f"or the path of one; repeatable (default: {', '.join(VERSIONS)})",
    )
    parser.add_argument("--dependencies", action="append", choices=RESOLUTIONS, help="repeatable (default: both)")
    parser.add_argument(
        "--select", metavar="EXPRESSION", default="not slow", help="tests, as for `pytest -m`; default: not slow"
    )
    parser.add_argument("--log", metavar="DIR", type=Path, default=Path("supported"), help="one file for each pair")


def command(arguments: Namespace) -> int:
    """Print a line for each pair; exit with 1 if any fails."""
    if which("uv") is None:
        raise InputError("uv is not found: pip install uv")
    arguments.log.mkdir(parents=True, exist_ok=True)
    failed = 0
    for python, dependencies in product(arguments.python or VERSIONS, arguments.dependencies or RESOLUTIONS):
        log = (arguments.log / f"{python.strip('/').replace('/', '-')}-{dependencies}.log").resolve()
        print(f"{python}, {dependencies} dependencies: ", end="", flush=True)
        step = run_tests(python, RESOLUTIONS[dependencies], arguments.select, log)
        print(f"failed to {step}, see {log}" if step else log.read_text("utf-8").splitlines()[-1])
        failed += step is not None
    return DONE if failed == 0 else 1


def run_tests(python: str, resolution: str, select: str, log: Path) -> str | None:
    """Install a clone and run its tests, both written to `log`; return the step that failed, or None."""
    with TemporaryDirectory() as folder, log.open("w", encoding="utf-8") as file:
        inside = str(Path(folder, ".venv", "bin", "python"))
        steps = {
            "clone": ["git", "clone", "--quiet", str(ROOT), "."],
            "make an environment": ["uv", "venv", "--python", python, ".venv"],
            "install": ["uv", "pip", "install", "--python", inside, "--resolution", resolution, ".[test]"],
            "test": [inside, "-m", "pytest", "-m", select],
        }
        for step, arguments in steps.items():
            if subprocess.run(arguments, cwd=folder, stdout=file, stderr=subprocess.STDOUT, check=False).returncode:
                return step
    return None
