"""`cellslam city generate`: a city drawn, with a scenario that drives in it."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from cellslam.benchmarks.trials.output_files import check_folder, write_text, writing
from cellslam.benchmarks.trials.trials import check_counts
from cellslam.cli.arguments import add
from cellslam.cli.cities import write_pictures
from cellslam.cli.output import note, note_long
from cellslam.progress_bars import bars
from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.city import build_city
from cellslam.sim.city.city_summary import summarise

EXAMPLES = ("city generate --seed 3 --set open_share=0.8 --out mycity",)
SITES = [
    {"name": name, "ports": 2, "cells": [{"cell_id": first + i, "azimuth_deg": turn + 120.0 * i} for i in range(3)]}
    for name, first, turn in (("A", 375, -180.0), ("B", 177, -150.0))
]
# Presets leave these out, as the cities that they were chosen with have none.
DETAILS = {"bay_share": 0.5, "shop_share": 0.3, "pole_spacing_m": 35.0}
VEHICLE = {"route": 1, "distance_m": 300.0, "duration_s": 300.0, "snapshot_interval_s": 0.075}
HEAD = """\
# Written by `cellslam city generate`. Positions of the sites are drawn in each trial unless position_m is
# given; `cellslam show` on this file lists every key.

"""


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "--seed", default=1, help="seed of the city (default: 1)")
    add(parser, "--set", help="change one key of the generator, as in open_share=0.8; may be repeated")
    add(parser, "--out", help="folder to write to (default: results/city-SEED)")
    add(parser, "--no-figures", help="do not draw pictures")


def command(arguments: Namespace) -> None:
    import tomli_w

    from cellslam.sim.city.files.mitsuba import write_scene
    from cellslam.sim.world import city_rng

    check_counts(1, arguments.seed)
    name = f"city-{arguments.seed}"
    out = Path(arguments.out or f"results/{name}")
    stub = out / f"{name}.toml"
    check_folder(out)
    keys = {key.removeprefix("city."): value for key, value in parse_all(arguments.sets).items()}
    tables: dict[str, Any] = {
        "title": f"a generated city, seed {arguments.seed}",
        "city": {"kind": "procedural", "seed": arguments.seed, **DETAILS, **keys},
        "sites": SITES,
        "vehicle": VEHICLE,
    }
    scenario = from_tables({"name": name, **tables})
    note_long(arguments, scenario.city)
    with bars(arguments.quiet) as progress, progress("building the city", 1):
        city = build_city(scenario.city, city_rng(scenario.world, 0, 0))
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        write_scene(city, out / "city.xml")
    write_text(stub, HEAD + tomli_w.dumps(tables))
    print("\n".join(summarise(city).lines()))
    pictures = [] if arguments.no_figures else write_pictures(city, out / "plan.png", out / "view.png", None)
    written = [out / "city.xml", stub, *pictures]
    note(arguments, f"wrote {', '.join(map(str, written))}; drive in it: cellslam run {stub}")
