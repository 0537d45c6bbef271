"""The columns of every table that can be imported, and a table of a campaign read in our units and on our clock.

`TABLES` is the one description of columns: their names, and the units in which each may be given.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellslam.recordings.importing.campaign import DEVIATIONS, QUANTITIES
from cellslam.recordings.importing.manifest import Column, Manifest
from cellslam.recordings.importing.tables import TableFile
from cellslam.sim.described import POSE_COLUMNS, POSITION_COLUMNS
from cellslam.sim.errors import InputError, nearest_name, unknown_name
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import COMPONENTS, Floats

Units = dict[str, float]  # what one of each is in ours, which comes first
TIME: Units = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH: Units = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
SAMPLES: Units = {"samples": np.nan}  # by [measurements] sample_rate_hz
DELAY: Units = LENGTH | {unit: SPEED_OF_LIGHT_MPS * factor for unit, factor in TIME.items()} | SAMPLES
ANGLE: Units = {"rad": 1.0, "deg": np.pi / 180.0}
RATE: Units = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
SPEED: Units = {"m/s": 1.0, "km/h": 1.0 / 3.6}
LEVEL: Units = {"dB": 1.0}

TABLES: dict[str, dict[str, Units]] = {
    "measurements": {
        "time_s": TIME,
        **dict(zip(QUANTITIES, (DELAY, ANGLE, ANGLE, LEVEL), strict=True)),
        **dict(zip(DEVIATIONS, (DELAY, ANGLE, ANGLE), strict=True)),
    },
    "snapshots": {"time_s": TIME},
    "odometry": {"time_s": TIME, **dict.fromkeys(COMPONENTS[:3], SPEED), **dict.fromkeys(COMPONENTS[3:], RATE)},
    "odometry of kind poses": {
        "time_s": TIME,
        **dict.fromkeys(POSITION_COLUMNS, LENGTH),
        **dict.fromkeys(POSE_COLUMNS[3:], ANGLE),
    },
    "reference": {
        "time_s": TIME,
        **dict.fromkeys(POSITION_COLUMNS, LENGTH),
        **dict.fromkeys(("latitude_rad", "longitude_rad", "yaw_rad"), ANGLE),
        "std_m": LENGTH,
    },
}


@dataclass(frozen=True)
class Table:
    """A table of a campaign: its file, its times (N,) in s on the recording's clock, its other columns (N,) in m, rad,
    m/s, rad/s or dB.
    """

    file: TableFile
    time_s: Floats
    columns: dict[str, Floats]


def read_table(folder: Path, manifest: Manifest, name: str) -> Table:
    """Return the table [name] of a manifest. Raises InputError naming column, unit, or row."""
    asked = getattr(manifest, name)
    described = TABLES["odometry of kind poses" if getattr(asked, "kind", "") == "poses" else name]
    for own, column in asked.columns.items():
        if own not in described:
            raise unknown_name(f"key of {name}.columns", own, described)
        if column.unit not in described[own]:
            allowed = ", ".join(described[own])
            raise InputError(f"{name}.columns.{own}: unit '{column.unit}' does not fit; give it in {allowed}")
    if "time_s" not in asked.columns:
        raise InputError(f"{name}.columns: 'time_s' is missing; name the column that holds the time")
    file, rate = TableFile(folder / asked.file, asked.variable, asked.delimiter), manifest.measurements.sample_rate_hz
    columns = {
        own: _in_our_unit(own, column, file.numbers(column.column), described[own], rate)
        for own, column in asked.columns.items()
    }
    return Table(file, _on_our_clock(columns.pop("time_s"), manifest, asked.clock), columns)


def _in_our_unit(name: str, column: Column, values: Floats, units: Units, sample_rate_hz: float | None) -> Floats:
    """Return a column (N,): (zero + sign * value) times the unit."""
    factor = units[column.unit]
    if column.unit in SAMPLES:
        if sample_rate_hz is None:
            raise InputError(f"measurements.columns.{name}: unit 'samples' needs measurements.sample_rate_hz")
        factor = SPEED_OF_LIGHT_MPS / sample_rate_hz
    # What needs no change keeps its last digit.
    if column.sign == 1 and column.zero == 0.0:
        return values if factor == 1.0 else values * factor
    return (column.zero + column.sign * values) * factor


def _on_our_clock(times: Floats, manifest: Manifest, name: str) -> Floats:
    """Return times (N,) in s of the clock `name`, empty for the recording's own, on the recording's."""
    if not name:
        return times
    if name not in manifest.clocks:
        near = nearest_name(name, manifest.clocks)
        raise InputError(f"clock '{name}' is not in [clocks]{near} (known: {', '.join(manifest.clocks) or 'none'})")
    clock = manifest.clocks[name]
    return clock.offset_s + (1.0 + 1e-6 * clock.drift_ppm) * times
