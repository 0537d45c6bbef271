"""Draw docs/images/architecture.svg: the rooms, and which uses which, read from the imports; and the way of the data.

python docs/draw_architecture.py        write the picture anew; a test holds it to the code
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
FLOORS = ("cellslam", "benchmarks", "scenarios", "slam", "sim")
# What a drive passes through, and the room that does it.
WAY = (
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
STYLE = """text{font:13px sans-serif;fill:#1b1b1b}.floor{fill:#f4f4f2;stroke:#b9b9b4}.room{fill:#fff;stroke:#0072b2}
.name{font-weight:600}.way{fill:#fff;stroke:#009e73}.use{fill:none;stroke:#8a8a86}.floors{fill:none;stroke:#d55e00;stroke-width:2}
.note{fill:#5a5a56}.small{font-size:10.5px;fill:#5a5a56}"""


def rooms(floor: str) -> list[str]:
    """Return the rooms of a floor: its folders with Python files, one level deep."""
    return sorted(p.name for p in (ROOT / floor).iterdir() if (p / "__init__.py").is_file() and not p.is_symlink())


def uses() -> dict[str, set[str]]:
    """Return for each room, as "floor/room" or "floor" for what stands in none, the others that it imports."""
    out: dict[str, set[str]] = {}
    for floor in FLOORS:
        for path in sorted((ROOT / floor).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            own = room_of(".".join(parts if floor == "cellslam" else ("cellslam", *parts)))
            out.setdefault(own, set()).update({room_of(name) for name in imported(path)} - {own})
    return out


def imported(path: Path) -> Iterator[str]:
    """Yield the dotted names of this package that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cellslam."):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room_of(name: str) -> str:
    """Return the room that a dotted name stands in."""
    _, floor, *rest = name.split(".")
    if floor not in FLOORS:
        floor, rest = "cellslam", [floor, *rest]
    return f"{floor}/{rest[0]}" if rest and rest[0] in rooms(floor) else floor


def reduced(graph: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Return the edges of a graph without cycles less those that a longer way implies."""

    def reach(node: str) -> set[str]:
        return graph[node].union(*(reach(other) for other in graph[node]))

    return sorted(
        (a, b) for a in graph for b in graph[a] if not any(b in reach(other) for other in graph[a] if other != b)
    )


def inside(floor: str, graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return what the rooms of one floor use of each other."""
    own = [f"{floor}/{room}" for room in rooms(floor)]
    return {room: graph[room] & set(own) for room in own}


def levels(graph: dict[str, set[str]]) -> dict[str, int]:
    """Return how far each room is from those that no other uses."""
    found: dict[str, int] = {}

    def level(room: str) -> int:
        if room not in found:
            found[room] = 1 + max((level(user) for user in graph if room in graph[user]), default=-1)
        return found[room]

    for room in graph:
        level(room)
    return found


def drawn() -> str:
    """Return the picture as SVG."""
    graph, parts, top = uses(), [*_way()], 130
    frames: dict[str, tuple[int, int]] = {}
    for floor in FLOORS:
        own = inside(floor, graph)
        height = _height(own)
        parts.append(_rect("floor", (MARGIN, top), (WIDTH - 2 * MARGIN, height)))
        parts.append(f'<text class="name" x="{MARGIN + 10}" y="{top + 21}">{floor}/</text>')
        parts += _rooms(own, top + 34)
        frames[floor] = (top, height)
        top += height + GAP
    for upper, lower in pairwise(FLOORS):
        start, end = sum(frames[upper]), frames[lower][0]
        parts.append(f'<path class="floors" marker-end="url(#big)" d="M{WIDTH // 2} {start} V{end - 4}"/>')
    note = (
        "arrows: uses; what a longer way implies is left out; all floors may use lower ones, slam of sim the recording"
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


def _way() -> Iterator[str]:
    yield f'<text class="name" x="{MARGIN}" y="28">the way of a drive</text>'
    step = (WIDTH - 2 * MARGIN) // len(WAY)
    for i, (what, room) in enumerate(WAY):
        x = MARGIN + i * step
        yield _rect("way", (x, 44), (step - 22, 48))
        yield f'<text x="{x + 8}" y="64">{escape(what)}</text><text class="small" x="{x + 8}" y="82">{room}</text>'
        if i:
            yield f'<path class="use" style="stroke:#009e73" marker-end="url(#green)" d="M{x - 22} 68 H{x - 1}"/>'


def _columns(graph: dict[str, set[str]]) -> list[list[str]]:
    found = levels(graph)
    return [sorted(room for room in found if found[room] == i) for i in range(1 + max(found.values(), default=-1))]


def _height(graph: dict[str, set[str]]) -> int:
    return 44 + STEP * max((len(column) for column in _columns(graph)), default=0)


def _rooms(graph: dict[str, set[str]], top: int) -> Iterator[str]:
    places = {}
    columns = _columns(graph)
    step = (WIDTH - 4 * MARGIN - BOX) // max(1, len(columns) - 1) if len(columns) > 1 else 0
    for i, column in enumerate(columns):
        for j, room in enumerate(column):
            places[room] = (2 * MARGIN + i * min(step, 220), top + j * STEP)
    for user, used in reduced(graph):
        (x, y), (u, v) = places[user], places[used]
        start, end, out, into = x + BOX, u - 1, y + HEIGHT // 2, v + HEIGHT // 2
        bend = (end - start) // 2
        curve = f"M{start} {out} C{start + bend} {out} {end - bend} {into} {end} {into}"
        yield f'<path class="use" marker-end="url(#small)" d="{curve}"/>'
    for room, (x, y) in places.items():
        yield _rect("room", (x, y), (BOX, HEIGHT))
        yield f'<text x="{x + 8}" y="{y + 20}">{room.partition("/")[2]}/</text>'


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
