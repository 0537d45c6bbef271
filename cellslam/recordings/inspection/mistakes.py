"""The table of mistakes that an import can make: the corrections that would undo each, and what to say about it.

`EXPLANATIONS` is the table; `suspicions` asks which of its rows makes the tables of a recording agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellslam.recordings.inspection.corrections import Correction
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

NANOSECOND_M = SPEED_OF_LIGHT_MPS * 1e-9
FOOT_M = 0.3048
DEGREE = np.pi / 180.0
SCALES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6, 2.0)
LATE_S = tuple(s * t for t in (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) for s in (-1.0, 1.0))
SHIFTS_M = tuple(s * b for b in (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0) for s in (-1.0, 1.0))
ARMS_M = tuple((x, y) for x in (-4.0, -2.0, 0.0, 2.0, 4.0) for y in (-2.0, 0.0, 2.0) if x or y)
ZEROS = [np.radians(z) for z in (30, 60, 90, 120, 150, -30, -60, -90, -120, -150)]
# What is nobody's mistake: scales within an eighth, clocks within half a second, zeros within twelve degrees.
SCALE, LATE, ZERO_RAD, SHIFT_M, ARM_M = 0.125, 0.45, np.radians(12.0), 4.0, 0.7
CLOSE, FAR_OFF = 0.1, 0.12  # a factor is recognised within so much of its logarithm, or such a share of it

Diagnosis = tuple[str, str]  # the kind of a mistake, and its remedy
CLOCKWISE = "the yaw rate is clockwise: set sign = -1 for u_psi"
RIGHT_HANDED = 'axes forward-right-down: say axes = "forward-right-down" for the odometry'
# Factors by field of `Correction`: each is tried, and named where a fitted factor comes near it.
FACTORS: dict[str, dict[float, Diagnosis]] = {
    "speed": {
        -1.0: (
            "odometry-sign",
            "the odometry has the wrong sign (forward is positive), or azimuths are counted from behind: set "
            "sign = -1 for u_x, or zero = 180 (deg) for azimuth_rad",
        ),
        1 / 3.6: ("speed-unit", 'speeds are in km/h, taken for m/s: say unit = "km/h" for u_x'),
        3.6: ("speed-unit", 'speeds are in m/s, taken for km/h: say unit = "m/s" for u_x'),
        FOOT_M: ("speed-unit", "speeds are in feet per second: multiply u_x by 0.3048"),
        1e-3: ("speed-unit", "speeds are in mm/s: multiply u_x by 0.001"),
        1e-2: ("speed-unit", "speeds are in cm/s: multiply u_x by 0.01"),
        0.44704: ("speed-unit", "speeds are in miles per hour: multiply u_x by 0.44704"),
    },
    "yaw_rate": {
        -1.0: ("clockwise", f"{CLOCKWISE} (or all of the odometry has {RIGHT_HANDED})"),
        DEGREE: ("degrees-as-radians", 'yaw rates in degrees are taken for radians: say unit = "deg/s" for u_psi'),
        -DEGREE: ("degrees-as-radians", f'yaw rates in degrees taken for radians: say unit = "deg/s"; and {CLOCKWISE}'),
        1 / DEGREE: ("radians-as-degrees", 'yaw rates in radians are taken for degrees: say unit = "rad/s" for u_psi'),
    },
    "distance": {
        NANOSECOND_M: ("nanoseconds", 'ns (or feet) are taken for metres: say unit = "ns" (or "ft") for distance_m'),
        1 / NANOSECOND_M: ("distance-unit", 'metres are taken for delays in ns: say unit = "m" for distance_m'),
        0.5: ("two-way", "ranges are two-way, there and back: halve them before the import"),
        2.0: ("two-way", "ranges were halved, though they are one-way: double them before the import"),
        1e3: ("distance-unit", 'kilometres are taken for metres: say unit = "km" for distance_m'),
        1e-3: ("distance-unit", 'millimetres are taken for metres: say unit = "mm" for distance_m'),
        1e-2: ("distance-unit", 'centimetres are taken for metres: say unit = "cm" for distance_m'),
    },
    "reference": {
        FOOT_M: ("reference-unit", 'the reference is in feet, taken for metres: say unit = "ft" for x_m and y_m'),
        1 / FOOT_M: ("reference-unit", 'the reference is in metres, taken for feet: say unit = "m" for x_m and y_m'),
        1e3: ("reference-unit", 'the reference is in km: say unit = "km" for x_m and y_m'),
        1e-2: ("reference-unit", 'the reference is in cm: say unit = "cm" for x_m and y_m'),
        1e-3: ("reference-unit", 'the reference is in mm: say unit = "mm" for x_m and y_m'),
    },
}
OTHER_FACTORS: dict[str, Diagnosis] = {
    "speed": ("speed-unit", "speeds fit if they are multiplied by {:.3g}: a wrong unit, wheel size or gear"),
    "yaw_rate": (
        "yaw-scale",
        "yaw rates fit if they are multiplied by {:.3g}: a wrong wheelbase (divide it by that), steering ratio or gyro "
        "scale",
    ),
    "distance": (
        "distance-unit",
        "distances fit if they are multiplied by {:.3g}: are they delays in samples? say unit = "
        '"samples" and sample_rate_hz',
    ),
    "reference": ("reference-unit", "the reference fits if it is multiplied by {:.3g}: a wrong unit"),
}
ARM_REMEDIES = {
    "odometry": "the point that the odometry measures: set odometry.lever_arm_m = {}",
    "reference": "the reference's antenna: set reference.lever_arm_m = {}",
    "measurements": "the point of odometry and reference: set lever_arm_m = {} in [odometry] and [reference]",
}


@dataclass(frozen=True)
class Explanation:
    """One kind of mistake: corrections to try, `diagnose` a kind and a remedy for the best of them.

    `refined`: values beside that of `field`, a `step` away; None where the corrections are all there are.
    `least`: log-likelihood that it must gain in a stretch: more for those that noise can imitate.
    `harmless` tells corrections too small to be a mistake: sound data may ask for them.
    """

    corrections: Sequence[Correction]
    diagnose: Callable[[Correction], Diagnosis]
    harmless: Callable[[Correction], bool] = lambda c: False
    field: str = ""
    refined: Callable[[Any, float], Sequence[Any]] | None = None
    step: float = 0.0
    least: float = 0.1

    def near(self, c: Correction, k: int) -> list[Correction]:
        """Return corrections about `c`, nearer with each round k; none where there is nothing to refine."""
        if self.refined is None:
            return []
        return [c.having(self.field, value) for value in self.refined(getattr(c, self.field), self.step / 2**k)]


def _scaled(factor: float, step: float) -> Sequence[float]:
    return factor * float(np.exp(-step)), factor * float(np.exp(step))


def _moved(value: float, step: float) -> Sequence[float]:
    return value - step, value + step


def _displaced(arm: tuple[float, float], step: float) -> Sequence[tuple[float, float]]:
    x, y = arm
    return (x + step, y), (x - step, y), (x, y + step), (x, y - step)


def _factors(field: str) -> list[Explanation]:
    """Return known factors, each an explanation of its own, and any other one."""

    def diagnose(c: Correction) -> Diagnosis:
        return _named(getattr(c, field), FACTORS[field], OTHER_FACTORS[field])

    def harmless(c: Correction) -> bool:
        factor = getattr(c, field)
        return factor > 0.0 and bool(abs(np.log(factor)) < SCALE)

    alone = [Explanation([Correction().having(field, value)], diagnose) for value in FACTORS[field]]
    starts = [value for value in FACTORS[field] if value != -1.0] + list(SCALES)
    other = [Correction().having(field, value) for value in starts]
    return [*alone, Explanation(other, diagnose, harmless, field, _scaled, step=0.07)]


def _named(factor: float, known: Mapping[float, Diagnosis], other: Diagnosis) -> Diagnosis:
    alike = [value for value in known if factor * value > 0.0]
    nearest = min(alike, key=lambda value: abs(np.log(factor / value)), default=np.inf)
    near = nearest in known and abs(np.log(factor / nearest)) < max(CLOSE, FAR_OFF * abs(np.log(abs(nearest))))
    return known[nearest] if near else (other[0], other[1].format(factor))


def _late(table: str) -> Explanation:
    field = f"{table}_late_s"

    def diagnose(c: Correction) -> Diagnosis:
        late = getattr(c, field)
        word = "late" if late > 0 else "early"
        remedy = f'set [clocks.NAME] offset_s = {-late:.2g} and clock = "NAME" in [{table}]'
        return f"{table}-clock", f"times of the {table} are {abs(late):.2g} s {word}: {remedy}"

    corrections = [Correction().having(field, late) for late in LATE_S]
    return Explanation(
        corrections, diagnose, lambda c: abs(getattr(c, field)) < LATE, field, _moved, step=0.5, least=0.75
    )


def _arm(table: str) -> Explanation:
    field = f"{table}_arm_m"

    def diagnose(c: Correction) -> Diagnosis:
        x, y = getattr(c, field)
        remedy = ARM_REMEDIES[table].format(f"[{x:.1f}, {y:.1f}, 0]")
        return "lever-arm", f"the array sits {x:.1f} m ahead and {y:.1f} m to the left of {remedy}"

    def harmless(c: Correction) -> bool:
        return bool(np.hypot(*getattr(c, field)) < ARM_M)

    corrections = [Correction().having(field, arm) for arm in ARMS_M]
    # A lag of the odometry, and ranges that are too long or short, look like an arm.
    return Explanation(corrections, diagnose, harmless, field, _displaced, step=1.0, least=0.75)


def _azimuth(c: Correction) -> Diagnosis:
    zero = float(np.degrees(c.azimuth_zero_rad))
    zero = zero if abs(zero - 90.0 * round(zero / 90.0)) > 8.0 else 90.0 * round(zero / 90.0)
    set_zero = f"zero = {zero:.0f} (deg) for azimuth_rad"
    if c.azimuth < 0.0 and zero == 0.0:
        return "clockwise", "azimuths are clockwise: set sign = -1 for azimuth_rad"
    if c.azimuth < 0.0:
        return "clockwise", f"azimuths are clockwise, and not counted from straight ahead: set sign = -1 and {set_zero}"
    side = "the right" if zero < 0.0 else "the left"
    return "azimuth-zero", f"azimuths are counted from {side}, or axes are swapped: set {set_zero}"


def _shift(c: Correction) -> Diagnosis:
    b = -c.distance_zero_m
    return "distance-offset", (
        f"every distance is {abs(b):.1f} m too {'long' if b > 0 else 'short'}, though clocks are given as known: set "
        f"zero = {-b:.1f} (m) for distance_m, or give the sites a clock_offset_std_m"
    )


def _right_handed(c: Correction) -> Diagnosis:
    only_yaw = "if its u_psi alone is clockwise, set sign = -1 for that"
    return "forward-right-down", f"the odometry has {RIGHT_HANDED} ({only_yaw})"


def _mirrored(c: Correction) -> Diagnosis:
    remedy = 'exchange x_m and y_m, or say axes = "north-east-down"'
    return "swapped-axes", f"x and y of the reference are swapped (north taken for east): {remedy}"


EXPLANATIONS = (
    *_factors("speed"),
    *_factors("yaw_rate"),
    Explanation([Correction(yaw_rate=-1.0, side=-1.0)], _right_handed),
    *(_late(table) for table in ("odometry", "measurements", "reference")),
    *(_arm(table) for table in ("odometry", "measurements", "reference")),
    Explanation([Correction(azimuth=-1.0)], _azimuth),
    Explanation(
        [Correction(azimuth=sign, azimuth_zero_rad=zero) for sign in (1.0, -1.0) for zero in ZEROS]
        + [Correction(azimuth=-1.0, azimuth_zero_rad=np.pi)],
        _azimuth,
        harmless=lambda c: c.azimuth > 0.0 and abs(c.azimuth_zero_rad) < ZERO_RAD,
        field="azimuth_zero_rad",
        refined=_moved,
        step=np.radians(10.0),
    ),
    *_factors("distance"),
    Explanation(
        [Correction(distance_zero_m=shift) for shift in SHIFTS_M],
        _shift,
        harmless=lambda c: abs(c.distance_zero_m) < SHIFT_M,
        field="distance_zero_m",
        refined=_moved,
        step=4.0,
    ),
    *_factors("reference"),
    Explanation([Correction(mirrored=True)], _mirrored),
)
