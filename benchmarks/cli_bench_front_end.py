"""`cellslam bench front-end` and `cellslam bench calibrate`."""

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
        raise InputError(f"--scenes {arguments.scenes} --seed {arguments.seed}: at least {LEAST_SCENES}, seed from 0 on")
    if arguments.out and not Path(arguments.out).resolve().parent.is_dir():
        raise InputError(f"--out {arguments.out}: its folder does not exist")
    from threadpoolctl import threadpool_limits

    from cellslam.benchmarks.calibration import agreement
    from cellslam.benchmarks.calibration import calibrate as study

    result: Any
    with bars(arguments.quiet) as progress, threadpool_limits(1):
        if arguments.check:
            result = [agreement(arguments.scenes, arguments.seed, ratio, progress) for ratio in (6.0, 15.0, 40.0)]
        else:
            result = study(arguments.scenes, arguments.seed, progress)
    text = json.dumps(result, indent=1) + "\n"
    if arguments.out:
        partial = Path(arguments.out).with_suffix(".tmp")
        partial.write_text(text, encoding="utf-8")
        partial.replace(arguments.out)
    else:
        sys.stdout.write(text)
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
