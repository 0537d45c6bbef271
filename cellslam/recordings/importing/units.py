"""Columns in the units, signs and clocks of a campaign, as ours: metres, radians, seconds, dB."""

from __future__ import annotations

import numpy as np

from cellslam.recordings.importing.manifest import Clock, Column
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import Floats

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}
RATES = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
SPEEDS = {"m/s": 1.0, "km/h": 1.0 / 3.6}
DELAYS = {**METRES, **{unit: SPEED_OF_LIGHT_MPS * factor for unit, factor in SECONDS.items()}}
# What each quantity may be given in, by the ending of our name.
KINDS = {"_s": SECONDS, "_m": METRES, "_rad": ANGLES, "_db": {"dB": 1.0}}
OWN = {
    "distance_m": DELAYS,
    "distance_std_m": DELAYS,
    "u_x": SPEEDS,
    "u_y": SPEEDS,
    "u_z": SPEEDS,
    "u_psi": RATES,
    "u_theta": RATES,
    "u_phi": RATES,
}


def known_columns(table: str, columns: dict[str, Column], known: tuple[str, ...]) -> None:
    """Raise InputError unless every column of [table.columns] is one of `known`, with a unit that fits, and time
    is there.
    """
    for name, column in columns.items():
        if name not in known:
            near = nearest_name(name, known)
            raise InputError(f"{table}.columns: unknown '{name}'{near} (known: {', '.join(known)})")
        factors = factors_of(name)
        if column.unit not in factors and not (column.unit == "samples" and name.startswith("distance_")):
            allowed = ", ".join([*factors, *(["samples"] if name.startswith("distance_") else [])])
            raise InputError(f"{table}.columns.{name}: unit '{column.unit}' does not fit; give it in {allowed}")
    if "time_s" not in columns:
        raise InputError(f"{table}.columns: 'time_s' is missing; name the column that holds the time")


def factors_of(name: str) -> dict[str, float]:
    """Return what each unit of a quantity is in ours."""
    if name in OWN:
        return OWN[name]
    return next(factors for ending, factors in KINDS.items() if name.endswith(ending))


def in_ours(name: str, column: Column, values: Floats, sample_rate_hz: float | None = None) -> Floats:
    """Return a column (N,) in our unit: (zero + sign * value) times the unit of m, rad, s or dB.

    Raises InputError where samples are to be converted without a sample rate (Hz).
    """
    if column.unit == "samples":
        if sample_rate_hz is None:
            raise InputError(f"measurements.columns.{name}: unit 'samples' needs measurements.sample_rate_hz")
        factor = SPEED_OF_LIGHT_MPS / sample_rate_hz
    else:
        factor = factors_of(name)[column.unit]
    if column.sign == 1 and column.zero == 0.0:
        return values if factor == 1.0 else values * factor
    return (column.zero + column.sign * values) * factor


def on_clock(times: Floats, clock: Clock) -> Floats:
    """Return times (N,) of a table, in s, on the recording's clock."""
    if clock.offset_s == 0.0 and clock.drift_ppm == 0.0:
        return times
    return clock.offset_s + (1.0 + 1e-6 * clock.drift_ppm) * times
