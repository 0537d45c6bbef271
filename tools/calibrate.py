"""`python -m tools calibrate`: the constants of the statistical front end, or their check."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from cellslam.cli.arguments import DONE
from cellslam.progress_bars import bars
from cellslam.sim.errors import InputError
from tools.studies_tables import print_studies

LEAST_SCENES = 50
CHECKED_DB = (6.0, 15.0)


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--technology", default="lte", choices=("lte", "nr"), help="waveform (default: lte)")
    parser.add_argument(
        "--resource-blocks",
        metavar="N",
        type=int,
        help="bandwidth (default: the technology's widest that is calibrated)",
    )
    parser.add_argument("--scenes", metavar="N", type=int, default=400, help="scenes of each kind (default: 400)")
    parser.add_argument("--seed", metavar="S", type=int, default=1, help="seed of the scenes (default: 1)")
    parser.add_argument("--out", metavar="FILE.json", help="write the constants here (default: print them)")
    parser.add_argument(
        "--check", action="store_true", help="compare the front ends, as calibrated, on scenes of their own instead"
    )
    parser.add_argument(
        "--ratio", metavar="DB", type=float, action="append", default=[], dest="ratios",
        help="specular-to-diffuse ratio of the check; may be repeated (default: 6 and 15)",
    )  # fmt: skip


def command(arguments: Namespace) -> int:
    """Carry out `python -m tools calibrate`."""
    if arguments.scenes < LEAST_SCENES or arguments.seed < 0:
        raise InputError(
            f"--scenes {arguments.scenes} --seed {arguments.seed}: at least {LEAST_SCENES}, seed from 0 on"
        )
    if any(not 0.0 <= ratio <= 40.0 for ratio in arguments.ratios):
        raise InputError(f"--ratio {max(arguments.ratios, key=abs):g}: specular over diffuse power, 0 to 40 dB")
    if arguments.out and not Path(arguments.out).resolve().parent.is_dir():
        raise InputError(f"--out {arguments.out}: its folder does not exist")
    from threadpoolctl import threadpool_limits

    from tools.calibration.front_end_check import agreement, records
    from tools.calibration.recurrence import recurring
    from tools.calibration.scenes import radio_of
    from tools.calibration.study import calibrate as study

    radio, rows = radio_of(arguments.technology, arguments.resource_blocks), dict[str, list[dict[str, Any]]]()
    with bars(arguments.quiet) as progress, threadpool_limits(1):
        if arguments.check:
            for ratio in arguments.ratios or CHECKED_DB:
                moving = recurring(radio, max(arguments.scenes // 6, 8), arguments.seed, ratio, progress)
                figures = agreement(radio, arguments.scenes, arguments.seed, ratio, progress) + moving
                rows[f"{ratio:g} dB"] = records(figures)
            text = json.dumps(rows, indent=1) + "\n"
        else:
            text = json.dumps(study(radio, arguments.scenes, arguments.seed, progress)) + "\n"
    if arguments.check:
        print_studies(rows)
    if arguments.out:
        partial = Path(arguments.out).with_suffix(".tmp")
        partial.write_text(text, encoding="utf-8")
        partial.replace(arguments.out)
    elif not arguments.check:
        sys.stdout.write(text)
    return DONE
