"""`cellslam simulate-from`: paths of another ray tracer, or measured ones, through our front end."""

from __future__ import annotations

import math
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import add, whole
from cellslam.cli.cities import add_transmitters, read_positions
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.sim.rays.exchange import Traced

EXAMPLES = ("simulate-from paths.npz tiny --out drive.h5",)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("paths", metavar="PATHS", help="Sionna RT's paths as .npz, or a DeepMIMO scenario's folder")
    add(parser, "scenario", "--set")
    add(parser, "--out", metavar="FILE.h5", required=True, help="the recording to write")
    add_transmitters(parser, help=".npz without 'sources': a transmitter in metres; may be repeated")
    parser.add_argument("--rx", metavar="RX.csv", help=".npz without 'targets': receivers, columns x,y,z")
    parser.add_argument("--polarisation", choices=("V", "H", "VH"), default="V", help=".npz: antennas (default: V)")
    tolerance_help = "how far delays and angles may miss geometry (default: 0.01,0.5; measured ones need more)"
    parser.add_argument("--tolerance", metavar="M,DEG", type=_tolerance, help=tolerance_help)
    parser.add_argument("--rx-set", metavar="N", type=whole, help="folder: the receiver set, where there are several")
    along_help = "positions x,y,z of a drive: take the receivers nearest to them (default: all, in order)"
    parser.add_argument("--along", metavar="POSITIONS.csv", help=along_help)
    add(parser, "--seed", "--trial")


def command(arguments: Namespace) -> None:
    from cellslam.scenarios.loading import load
    from cellslam.scenarios.overrides import parse_all
    from cellslam.scenarios.simulation import along, simulate_paths

    out, place = Path(arguments.out), Path(arguments.paths)
    check_file(out)
    scenario = load(arguments.scenario, parse_all(arguments.sets))
    traced = _read(place, arguments)
    if arguments.along:
        traced = along(traced, read_positions(Path(arguments.along))[0])
    with bars(arguments.quiet) as progress:
        recording = simulate_paths(scenario, traced, place.name, arguments.seed, arguments.trial, progress)
        recording.save(out)
    count = len(recording.measurements)
    note(arguments, f"{out}: {len(recording.time_s)} snapshots, {len(traced.paths)} paths, {count} measurements")


def _read(place: Path, arguments: Namespace) -> Traced:
    from cellslam.sim.rays.exchange import EXACT, Tolerance, read_deepmimo, read_sionna

    tolerance = EXACT if arguments.tolerance is None else Tolerance(*arguments.tolerance)
    if place.is_dir():
        return read_deepmimo(place, arguments.rx_set, tolerance)
    if not place.is_file():
        raise InputError(f"{place}: no such file or folder; give Sionna RT's paths as .npz, or a DeepMIMO folder")
    transmitters = np.array(arguments.bs) if arguments.bs else None
    receivers = read_positions(Path(arguments.rx))[0] if arguments.rx else None
    return read_sionna(place, arguments.polarisation, transmitters, receivers, tolerance)


def _tolerance(text: str) -> tuple[float, float]:
    """Return metres and radians. Raises ArgumentTypeError."""
    try:
        metres, degrees = (float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"'{text}' is no METRES,DEGREES, as in 5,10") from None
    if not (metres > 0.0 and 0.0 < degrees < 90.0):
        raise ArgumentTypeError(f"'{text}' is out of range: metres above 0, degrees above 0 and below 90")
    return metres, math.radians(degrees)
