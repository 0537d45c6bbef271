"""Draw docs/images/architecture.svg: the packages, which of them uses which by the imports, and the flow of data.

python docs/draw_architecture.py        write the picture anew; a test holds it to the code
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
LAYERS = ("cellslam", "benchmarks", "scenarios", "slam", "sim")
# What a drive passes through, and the package that does it.
FLOW = (
    ("mesh or seed", ""),
    ("city", "sim/city"),
    ("rays", "sim/rays"),
    ("drive", "sim/vehicle"),
    ("front end", "sim/lte"),
    ("recording", "sim/recording"),
    ("estimator", "slam/joint"),
    ("scores, bound", "benchmarks/scores"),
    ("table, report", "benchmarks/tables"),
)
WIDTH, MARGIN, BOX, HEIGHT, STEP, GAP = 1180, 20, 108, 30, 46, 24
STYLE = """text{font:13px sans-serif;fill:#1b1b1b}.layer{fill:#f4f4f2;stroke:#b9b9b4}.package{fill:#fff;stroke:#0072b2}
.name{font-weight:600}.flow{fill:#fff;stroke:#009e73}.use{fill:none;stroke:#8a8a86}.layers{fill:none;stroke:#d55e00;stroke-width:2}
.note{fill:#5a5a56}.small{font-size:10.5px;fill:#5a5a56}"""


def packages(layer: str) -> list[str]:
    """Return the packages of a layer: its folders with Python files, one level deep."""
    return sorted(p.name for p in (ROOT / layer).iterdir() if (p / "__init__.py").is_file() and not p.is_symlink())


@cache
def uses() -> dict[str, set[str]]:
    """Return for each package, as "layer/package" or "layer" for what stands in none, the others that it imports."""
    out: dict[str, set[str]] = {}
    for layer in LAYERS:
        for path in sorted((ROOT / layer).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            own = package_of(".".join(parts if layer == "cellslam" else ("cellslam", *parts)))
            out.setdefault(own, set()).update({package_of(name) for name in imported(path)} - {own})
    return out


def imported(path: Path) -> Iterator[str]:
    """Yield the dotted names of this package that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cellslam."):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def package_of(name: str) -> str:
    """Return the package that a dotted name stands in."""
    _, layer, *rest = name.split(".")
    if layer not in LAYERS:
        layer, rest = "cellslam", [layer, *rest]
    return f"{layer}/{rest[0]}" if rest and rest[0] in packages(layer) else layer


def reduced(graph: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Return the edges of a graph without cycles less those that a longer path implies."""

    def reach(node: str) -> set[str]:
        return graph[node].union(*(reach(other) for other in graph[node]))

    return sorted(
        (a, b) for a in graph for b in graph[a] if not any(b in reach(other) for other in graph[a] if other != b)
    )


def inside(layer: str, graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return what the packages of one layer use of each other."""
    own = [f"{layer}/{package}" for package in packages(layer)]
    return {package: graph[package] & set(own) for package in own}


def levels(graph: dict[str, set[str]]) -> dict[str, int]:
    """Return how far each package is from those that no other uses."""
    found: dict[str, int] = {}

    def level(package: str) -> int:
        if package not in found:
            found[package] = 1 + max((level(user) for user in graph if package in graph[user]), default=-1)
        return found[package]

    for package in graph:
        level(package)
    return found


def drawn() -> str:
    """Return the picture as SVG."""
    graph, parts, top = uses(), [*_flow()], 130
    frames: dict[str, tuple[int, int]] = {}
    for layer in LAYERS:
        own = inside(layer, graph)
        height = _height(own)
        parts.append(_rect("layer", (MARGIN, top), (WIDTH - 2 * MARGIN, height)))
        parts.append(f'<text class="name" x="{MARGIN + 10}" y="{top + 21}">{layer}/</text>')
        parts += _packages(own, top + 34)
        frames[layer] = (top, height)
        top += height + GAP
    for upper, lower in pairwise(LAYERS):
        start, end = sum(frames[upper]), frames[lower][0]
        parts.append(f'<path class="layers" marker-end="url(#big)" d="M{WIDTH // 2} {start} V{end - 4}"/>')
    note = (
        "arrows: uses; what a longer path implies is left out; all layers may use lower ones, slam of sim the recording"
    )
    parts.append(f'<text class="note" x="{MARGIN}" y="{top}">{note}</text>')
    arrow = '<path d="M0 0 L8 4 L0 8 z" fill="{0}"/>'
    markers = "".join(
        f'<marker id="{name}" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto" '
        f'markerUnits="userSpaceOnUse">{arrow.format(colour)}</marker>'
        for name, colour in (("small", "#8a8a86"), ("big", "#d55e00"), ("green", "#009e73"))
    )
    size = f'viewBox="0 0 {WIDTH} {top + 16}" width="{WIDTH}" height="{top + 16}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    back = f'<rect width="{WIDTH}" height="{top + 16}" fill="#fff"/>'
    return "\n".join([head, f"<style>{STYLE}</style><defs>{markers}</defs>", back, *parts, "</svg>", ""])


def _rect(kind: str, place: tuple[int, int], size: tuple[int, int]) -> str:
    (x, y), (width, height) = place, size
    return f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="5"/>'


def _flow() -> Iterator[str]:
    yield f'<text class="name" x="{MARGIN}" y="28">the flow of a drive</text>'
    step = (WIDTH - 2 * MARGIN) // len(FLOW)
    for i, (what, package) in enumerate(FLOW):
        x = MARGIN + i * step
        yield _rect("flow", (x, 44), (step - 22, 48))
        yield f'<text x="{x + 8}" y="64">{escape(what)}</text><text class="small" x="{x + 8}" y="82">{package}</text>'
        if i:
            yield f'<path class="use" style="stroke:#009e73" marker-end="url(#green)" d="M{x - 22} 68 H{x - 1}"/>'


def _columns(graph: dict[str, set[str]]) -> list[list[str]]:
    level = levels(graph)
    return [sorted(p for p in level if level[p] == i) for i in range(1 + max(level.values(), default=-1))]


def _height(graph: dict[str, set[str]]) -> int:
    return 44 + STEP * max((len(column) for column in _columns(graph)), default=0)


def _packages(graph: dict[str, set[str]], top: int) -> Iterator[str]:
    places = {}
    columns = _columns(graph)
    step = (WIDTH - 4 * MARGIN - BOX) // max(1, len(columns) - 1) if len(columns) > 1 else 0
    for i, column in enumerate(columns):
        for j, package in enumerate(column):
            places[package] = (2 * MARGIN + i * min(step, 220), top + j * STEP)
    for user, used in reduced(graph):
        (x, y), (u, v) = places[user], places[used]
        start, end, out, into = x + BOX, u - 1, y + HEIGHT // 2, v + HEIGHT // 2
        bend = (end - start) // 2
        curve = f"M{start} {out} C{start + bend} {out} {end - bend} {into} {end} {into}"
        yield f'<path class="use" marker-end="url(#small)" d="{curve}"/>'
    for package, (x, y) in places.items():
        yield _rect("package", (x, y), (BOX, HEIGHT))
        yield f'<text x="{x + 8}" y="{y + 20}">{package.partition("/")[2]}/</text>'


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
