"""`cellslam city inspect`, `generate` and `trace`."""

from __future__ import annotations

import dataclasses
import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.bars import bars
from cellslam.benchmarks.cli import DONE
from cellslam.benchmarks.output import check_file, check_folder, file_name
from cellslam.benchmarks.places import find_city, parse_positions, read_positions, write_paths
from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.city import City, build_city
from cellslam.sim.city.summary import Summary, summarise
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.rays.paths import Floats

STUB_SITES = [
    {
        "name": name,
        "ports": 2,
        "cells": [{"cell_id": first + i, "azimuth_deg": turn + 120.0 * i} for i in range(3)],
    }
    for name, first, turn in (("A", 375, -180.0), ("B", 177, -150.0))
]
# Presets leave these out, as the cities that they were chosen with have none.
STUB_DETAILS = {"bay_share": 0.5, "shop_share": 0.3, "pole_spacing_m": 35.0}
STUB_VEHICLE = {"route": 1, "distance_m": 300.0, "duration_s": 300.0, "snapshot_interval_s": 0.075}


def inspect(arguments: Namespace) -> int:
    """Carry out `cellslam city inspect`."""
    if arguments.html:
        from cellslam.benchmarks.figures.html import check_plotly

        check_plotly()
    out = Path(arguments.out or f"results/city-{file_name(Path(arguments.mesh).name.partition('.')[0])}")
    draws = arguments.html or not arguments.no_figures
    if draws:
        check_folder(out)
    with bars(arguments.quiet) as progress, progress("reading the city", 1):
        city = find_city(arguments.mesh, **_mesh_options(arguments))
    summary = summarise(city)
    sys.stdout.write(_json(summary) if arguments.json else "\n".join(summary.lines()) + "\n")
    sys.stdout.flush()
    if draws:
        written = _pictures(city, out, plain=not arguments.no_figures, html=arguments.html)
        _note(arguments, f"pictures: {', '.join(map(str, written))}")
    return DONE


def generate(arguments: Namespace) -> int:
    """Carry out `cellslam city generate`."""
    from cellslam.sim.city.export import write_scene
    from cellslam.sim.world import city_rng

    if arguments.seed < 0:
        raise InputError(f"seed = {arguments.seed}: must be 0 or more")
    name = f"city-{arguments.seed}"
    out = Path(arguments.out or f"results/{name}")
    stub = out / f"{name}.toml"
    check_folder(out)
    keys = {key.removeprefix("city."): value for key, value in parse_all(arguments.sets).items()}
    tables: dict[str, Any] = {
        "title": f"a generated city, seed {arguments.seed}",
        "city": {"kind": "procedural", "seed": arguments.seed, **STUB_DETAILS, **keys},
        "sites": STUB_SITES,
        "vehicle": STUB_VEHICLE,
    }
    scenario = from_tables({"name": name, **tables})
    with bars(arguments.quiet) as progress, progress("building the city", 1):
        city = build_city(scenario.city, city_rng(scenario.world, 0, 0))
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_scene(city, out / "city.xml")
        stub.write_text(_stub(tables), "utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error})") from None
    sys.stdout.write("\n".join(summarise(city).lines()) + "\n")
    pictures = [] if arguments.no_figures else _pictures(city, out, plain=True, html=False)
    written = [out / "city.xml", stub, *pictures]
    _note(arguments, f"wrote {', '.join(map(str, written))}; drive in it: cellslam run {stub}")
    return DONE


def trace_paths(arguments: Namespace) -> int:
    """Carry out `cellslam city trace`."""
    from cellslam.sim.city.inside import OUTSIDE, check_outside, enclosing
    from cellslam.sim.rays import prepare, trace

    pictures = [Path(p) for p in (arguments.plan, arguments.view, arguments.html) if p]
    for path in (Path(arguments.out), *pictures):
        check_file(path)
    if arguments.html:
        from cellslam.benchmarks.figures.html import check_plotly

        check_plotly()
    transmitters = parse_positions(arguments.bs, "--bs")
    receivers, velocity = read_positions(Path(arguments.rx))
    with bars(arguments.quiet) as progress:
        with progress("reading the city", 1):
            city = find_city(arguments.mesh, **_mesh_options(arguments))
        check_outside(city, transmitters, "--bs: transmitter")
        scene = prepare(city)
        paths = trace(
            scene, transmitters, receivers, arguments.max_order, carrier_hz=arguments.carrier,
            ground_reflection=arguments.ground, diffraction=arguments.diffraction, progress=progress,
        )  # fmt: skip
        doppler = None if velocity is None else paths.doppler_hz(velocity, arguments.carrier)
        write_paths(Path(arguments.out), paths, doppler)
        _draw(arguments, city, paths, transmitters, receivers)
    inside = int(np.count_nonzero(enclosing(city, receivers) != OUTSIDE))
    counts = np.bincount(paths.order[paths.edge < 0], minlength=arguments.max_order + 1)
    kinds = ", ".join(f"{count} of order {order}" for order, count in enumerate(counts))
    kinds += f", {np.count_nonzero(paths.edge >= 0)} diffracted" if arguments.diffraction else ""
    _note(arguments, f"{arguments.out}: {len(paths)} paths to {len(receivers)} receivers ({kinds})")
    if inside:
        _note(arguments, f"note: {inside} of {len(receivers)} receivers are inside buildings or under the ground")
    return DONE


def _draw(arguments: Namespace, city: City, paths: Paths, transmitters: Floats, receivers: Floats) -> None:
    if arguments.plan or arguments.view:
        from cellslam.benchmarks.figures.city import draw_plan, draw_view

        for path, draw in ((arguments.plan, draw_plan), (arguments.view, draw_view)):
            if path:
                draw(Path(path), city, paths, transmitters, receivers)
    if arguments.html:
        from cellslam.benchmarks.figures.html import write_html

        write_html(Path(arguments.html), city, paths, transmitters, receivers)


def _pictures(city: City, out: Path, plain: bool, html: bool) -> list[Path]:
    """Write the plan and the view of a city, or its interactive page, into `out`; return the files."""
    from cellslam.benchmarks.figures.city import draw_plan, draw_view

    out.mkdir(parents=True, exist_ok=True)
    written = []
    if plain:
        written = [out / "plan.png", out / "view.png"]
        draw_plan(written[0], city)
        draw_view(written[1], city)
    if html:
        from cellslam.benchmarks.figures.html import write_html
        from cellslam.sim.rays import trace

        nowhere = np.empty((0, 3))
        written.append(out / "city.html")
        write_html(written[-1], city, trace(city, nowhere, nowhere), nowhere, nowhere)
    return written


def _stub(tables: dict[str, Any]) -> str:
    import tomli_w

    return (
        "# Written by `cellslam city generate`. Positions of the sites are drawn in each trial unless position_m is\n"
        "# given; `cellslam show` on this file lists every key.\n\n" + tomli_w.dumps(tables)
    )


def _json(summary: Summary) -> str:
    plain = {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in dataclasses.asdict(summary).items()
    }
    return json.dumps(plain, indent=1) + "\n"


def _mesh_options(arguments: Namespace) -> dict[str, Any]:
    return {key: getattr(arguments, key) for key in ("material", "up", "plane_tolerance_m", "angle_tolerance_deg")}


def _note(arguments: Namespace, text: str) -> None:
    if not arguments.quiet:
        sys.stderr.write(f"{text}\n")
