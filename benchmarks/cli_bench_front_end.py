"""`cellslam bench front-end`, `bench calibrate` and `bench snapshot`."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bars import bars
from cellslam.benchmarks.cli import DONE
from cellslam.benchmarks.cli_front_end_parsers import STUDIES
from cellslam.sim.errors import InputError

LEAST_SCENES = 50
CHECKED_DB = (6.0, 15.0)


def front_end(arguments: Namespace) -> int:
    """Carry out `cellslam bench front-end`."""
    if arguments.runs < 2 or arguments.seed < 0:
        raise InputError(f"--runs {arguments.runs} --seed {arguments.seed}: at least 2 runs and a seed from 0 on")
    from threadpoolctl import threadpool_limits

    from cellslam.benchmarks.bench_front_end_tables import studies

    with bars(arguments.quiet) as progress, threadpool_limits(1):
        wanted = arguments.studies or STUDIES
        rows = studies(wanted, arguments.runs, arguments.seed, progress)
    if arguments.json:
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
    else:
        _print(rows)
    return DONE


def calibrate(arguments: Namespace) -> int:
    """Carry out `cellslam bench calibrate`."""
    if arguments.scenes < LEAST_SCENES or arguments.seed < 0:
        raise InputError(
            f"--scenes {arguments.scenes} --seed {arguments.seed}: at least {LEAST_SCENES}, seed from 0 on"
        )
    if any(not 0.0 <= ratio <= 40.0 for ratio in arguments.ratios):
        raise InputError(f"--ratio {max(arguments.ratios, key=abs):g}: specular over diffuse power, 0 to 40 dB")
    if arguments.out and not Path(arguments.out).resolve().parent.is_dir():
        raise InputError(f"--out {arguments.out}: its folder does not exist")
    from threadpoolctl import threadpool_limits

    from cellslam.benchmarks.calibration import calibrate as study
    from cellslam.benchmarks.calibration_check import agreement, records

    rows: dict[str, list[dict[str, Any]]] = {}
    with bars(arguments.quiet) as progress, threadpool_limits(1):
        if arguments.check:
            for ratio in arguments.ratios or CHECKED_DB:
                rows[f"{ratio:g} dB"] = records(agreement(arguments.scenes, arguments.seed, ratio, progress))
            text = json.dumps(rows, indent=1) + "\n"
        else:
            text = json.dumps(study(arguments.scenes, arguments.seed, progress)) + "\n"
    if arguments.check:
        _print(rows)
    if arguments.out:
        partial = Path(arguments.out).with_suffix(".tmp")
        partial.write_text(text, encoding="utf-8")
        partial.replace(arguments.out)
    elif not arguments.check:
        sys.stdout.write(text)
    return DONE


def snapshot(arguments: Namespace) -> int:
    """Carry out `cellslam bench snapshot`."""
    from cellslam.benchmarks.figures.snapshot import draw_snapshot
    from cellslam.scenarios.loading import load
    from cellslam.scenarios.overrides import parse_all
    from cellslam.sim.world import prepare

    if arguments.seed < 0:
        raise InputError(f"--seed {arguments.seed}: a whole number from 0 on")
    out = Path(arguments.out)
    if out.suffix != ".png" or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: a .png in a folder that exists is expected")
    scenario = load(arguments.scenario, parse_all([*arguments.sets, "radio.front_end=signal"]))
    with bars(arguments.quiet) as progress:
        world = prepare(scenario.world, arguments.seed, 0, progress)
        last = len(world.drive.poses) - 1
        if not 0 <= arguments.at <= last:
            raise InputError(f"--at {arguments.at}: the drive has snapshots 0 to {last}")
        for line in draw_snapshot(world, arguments.at, arguments.link, out):
            sys.stdout.write(line + "\n")
    return DONE


def _print(rows: dict[str, list[dict[str, Any]]]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=130)
    for study, lines in rows.items():
        table = Table(title=study, title_justify="left")
        for column in lines[0]:
            table.add_column(column, justify="right")
        for line in lines:
            table.add_row(*(_cell(line.get(column)) for column in lines[0]))
        console.print(table)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_cell(v) for v in value)
    if isinstance(value, float | np.floating):
        return f"{value:.3g}"
    return "-" if value is None else str(value)
