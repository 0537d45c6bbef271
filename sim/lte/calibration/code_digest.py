"""With what code the constants of the statistical front end were measured, and whether that is still the code."""

from __future__ import annotations

import ast
import hashlib
import json
from pathlib import Path
from typing import Any

from cellslam.sim.lte.statistical.statistics import LTE, file_of

SIM = Path(__file__).parents[2]
# The signal-level front end, processes and blocks aside, and what it shares with the statistical one.
CODE = ("lte/signal", "lte/array.py", "lte/joint_bound.py", "lte/links.py", "lte/persisting_errors_kernel.py",
        "lte/downlink", "lte/single_path_bound.py", "lte/steering_kernel.py",
        "lte/statistical/detector_layout.py", "rays/antenna.py", "waveform")  # fmt: skip
RUNNING = ("block_processes.py", "drive_in_blocks.py")
_UNSEEN = {"annotation", "returns", "type_comment", "type_params", "kind"}


def code_digest(sim: Path = SIM) -> str:
    """Return a digest of the signal-level front end's code in the folder `sim`.

    Comments, docstrings, formatting, annotations and imports are not in it, nor is the version of Python.
    """
    files = [f for part in CODE for f in ([sim / part] if part.endswith(".py") else sorted((sim / part).rglob("*.py")))]
    code = [_plain(ast.parse(f.read_text("utf-8"))) for f in files if f.name not in RUNNING]
    return hashlib.sha256(repr(code).encode()).hexdigest()[:16]


def _plain(node: Any) -> Any:
    """Return a syntax tree as nested lists, without what does not act."""
    if isinstance(node, list):
        return [_plain(item) for item in node if not _idle(item)]
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        node = ast.Assign([node.target], node.value)
    if not isinstance(node, ast.AST):
        return node
    fields = [(name, _plain(value)) for name, value in ast.iter_fields(node) if name not in _UNSEEN]
    return [type(node).__name__, *(field for field in fields if field[1] not in (None, []))]


def _idle(node: Any) -> bool:
    text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    typing = isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    return text or typing or isinstance(node, (ast.Import, ast.ImportFrom))


def outdated(sim: Path = SIM, band: str = LTE) -> str:
    """Return a line that says that a band's shipped constants were measured with other code; empty if they were not."""
    file, now = file_of(band), code_digest(sim)
    then = json.loads(file.read_text("utf-8"))["provenance"]["code"]
    if then == now:
        return ""
    return f"{file.name} was measured with other code ({then}) of the signal level than this ({now}): measure it again"
