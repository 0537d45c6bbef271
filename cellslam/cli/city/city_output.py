"""Pictures of a city, and notes on stderr."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from cellslam.sim.city import City


def write_pictures(city: City, out: Path, plain: bool, html: bool) -> list[Path]:
    """Write the plan and the view of a city, or its interactive page, into `out`; return the files."""
    from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view

    out.mkdir(parents=True, exist_ok=True)
    written = []
    if plain:
        written = [out / "plan.png", out / "view.png"]
        draw_plan(written[0], city)
        draw_view(written[1], city)
    if html:
        from cellslam.benchmarks.report.city_page import write_city

        written.append(out / "city.html")
        write_city(written[-1], city)
    return written


def note(arguments: Namespace, text: str) -> None:
    """Say something on stderr, unless --quiet."""
    if not arguments.quiet:
        sys.stderr.write(f"{text}\n")
