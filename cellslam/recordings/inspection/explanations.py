"""Mistakes that an import can make: the corrections that would undo each, and what to say about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

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
# What is nobody's mistake: scales within an eighth, clocks within half a second, zeros within twelve degrees.
SCALE, LATE, ZERO_RAD, SHIFT_M, ARM_M = 0.125, 0.45, np.radians(12.0), 4.0, 0.7
CLOSE, FAR_OFF = 0.1, 0.12  # a factor is recognised within so much of its logarithm, or such a share of it

Say = Callable[[Correction], tuple[str, str]]


@dataclass(frozen=True)
class Explanation:
    """One kind of mistake: corrections to try, how to refine the best of them, `say` a kind and a remedy for it.

    `least`: log-likelihood that it must gain in a stretch: more for those that noise can imitate.
    `harmless` tells corrections too small to be a mistake: sound data may ask for them.
    """

    corrections: Sequence[Correction]
    say: Say
    harmless: Callable[[Correction], bool] = lambda c: False
    refined: Callable[[Correction, int], Iterator[Correction]] | None = None
    least: float = 0.1

    def near(self, c: Correction, k: int) -> list[Correction]:
        """Return corrections about `c`, nearer with each round k; none where there is nothing to refine."""
        return [] if self.refined is None else list(self.refined(c, k))


def _scaled(field: str) -> Callable[[Correction, int], Iterator[Correction]]:
    """Return corrections about one whose `field` is a factor, nearer with each round k."""

    def refined(c: Correction, k: int) -> Iterator[Correction]:
        for step in (-1.0, 1.0):
            yield c.having(field, getattr(c, field) * float(np.exp(step * 0.07 / 2**k)))

    return refined


def _moved(field: str, step: float) -> Callable[[Correction, int], Iterator[Correction]]:
    def refined(c: Correction, k: int) -> Iterator[Correction]:
        for sign in (-1.0, 1.0):
            yield c.having(field, getattr(c, field) + sign * step / 2**k)

    return refined


def _turned(field: str) -> Callable[[Correction, int], Iterator[Correction]]:
    def refined(c: Correction, k: int) -> Iterator[Correction]:
        x, y = getattr(c, field)
        for dx, dy in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            yield c.having(field, (x + dx / 2**k, y + dy / 2**k))

    return refined


def _named(factor: float, known: Mapping[float, tuple[str, str]], other: tuple[str, str]) -> tuple[str, str]:
    alike = [value for value in known if factor * value > 0.0]
    nearest = min(alike, key=lambda value: abs(np.log(factor / value)), default=np.inf)
    near = nearest in known and abs(np.log(factor / nearest)) < max(CLOSE, FAR_OFF * abs(np.log(abs(nearest))))
    return known[nearest] if near else (other[0], other[1].format(factor))


def _speed(c: Correction) -> tuple[str, str]:
    if c.speed < 0.0:
        return "odometry-sign", (
            "the odometry has the wrong sign (forward is positive), or azimuths are counted from behind: set "
            "sign = -1 for u_x, or zero = 180 (deg) for azimuth_rad"
        )
    known = {
        1 / 3.6: ("speed-unit", 'speeds are in km/h, taken for m/s: say unit = "km/h" for u_x'),
        3.6: ("speed-unit", 'speeds are in m/s, taken for km/h: say unit = "m/s" for u_x'),
        FOOT_M: ("speed-unit", "speeds are in feet per second: multiply u_x by 0.3048"),
        1e-3: ("speed-unit", "speeds are in mm/s: multiply u_x by 0.001"),
        1e-2: ("speed-unit", "speeds are in cm/s: multiply u_x by 0.01"),
        0.44704: ("speed-unit", "speeds are in miles per hour: multiply u_x by 0.44704"),
    }  # fmt: skip
    other = ("speed-unit", "speeds fit if they are multiplied by {:.3g}: a wrong unit, wheel size or gear")
    return _named(c.speed, known, other)


def _yaw_rate(c: Correction) -> tuple[str, str]:
    turned = "the yaw rate is clockwise: set sign = -1 for u_psi"
    frame = 'axes forward-right-down: say axes = "forward-right-down" for the odometry'
    if c.side < 0.0:
        return (
            "forward-right-down",
            f"the odometry has {frame} (if its u_psi alone is clockwise, set sign = -1 for that)",
        )
    known = {
        -1.0: ("clockwise", f"{turned} (or all of the odometry has {frame})"),
        DEGREE: ("degrees-as-radians", 'yaw rates in degrees are taken for radians: say unit = "deg/s" for u_psi'),
        -DEGREE: ("degrees-as-radians", f'yaw rates in degrees taken for radians: say unit = "deg/s"; and {turned}'),
        1 / DEGREE: ("radians-as-degrees", 'yaw rates in radians are taken for degrees: say unit = "rad/s" for u_psi'),
    }  # fmt: skip
    other = (
        "yaw-scale",
        "yaw rates fit if they are multiplied by {:.3g}: a wrong wheelbase (divide it by that), steering ratio or gyro "
        "scale",
    )
    return _named(c.yaw_rate, known, other)


def _azimuth(c: Correction) -> tuple[str, str]:
    zero = float(np.degrees(c.azimuth_zero_rad))
    zero = zero if abs(zero - 90.0 * round(zero / 90.0)) > 8.0 else 90.0 * round(zero / 90.0)
    set_zero = f"zero = {zero:.0f} (deg) for azimuth_rad"
    if c.azimuth < 0.0 and zero == 0.0:
        return "clockwise", "azimuths are clockwise: set sign = -1 for azimuth_rad"
    if c.azimuth < 0.0:
        return "clockwise", f"azimuths are clockwise, and not counted from straight ahead: set sign = -1 and {set_zero}"
    side = "the right" if zero < 0.0 else "the left"
    return "azimuth-zero", f"azimuths are counted from {side}, or axes are swapped: set {set_zero}"


def _distance(c: Correction) -> tuple[str, str]:
    known = {
        NANOSECOND_M: ("nanoseconds", 'ns (or feet) are taken for metres: say unit = "ns" (or "ft") for distance_m'),
        1 / NANOSECOND_M: ("distance-unit", 'metres are taken for delays in ns: say unit = "m" for distance_m'),
        0.5: ("two-way", "ranges are two-way, there and back: halve them before the import"),
        2.0: ("two-way", "ranges were halved, though they are one-way: double them before the import"),
        1e3: ("distance-unit", 'kilometres are taken for metres: say unit = "km" for distance_m'),
        1e-3: ("distance-unit", 'millimetres are taken for metres: say unit = "mm" for distance_m'),
        1e-2: ("distance-unit", 'centimetres are taken for metres: say unit = "cm" for distance_m'),
    }  # fmt: skip
    other = (
        "distance-unit",
        "distances fit if they are multiplied by {:.3g}: are they delays in samples? say unit = "
        '"samples" and sample_rate_hz',
    )
    return _named(c.distance, known, other)


def _shift(c: Correction) -> tuple[str, str]:
    b = -c.distance_zero_m
    return "distance-offset", (
        f"every distance is {abs(b):.1f} m too {'long' if b > 0 else 'short'}, though clocks are said to be known: set "
        f"zero = {-b:.1f} (m) for distance_m, or give the sites a clock_offset_std_m"
    )


def _late(table: str, field: str) -> Say:
    def say(c: Correction) -> tuple[str, str]:
        late = getattr(c, field)
        word = "late" if late > 0 else "early"
        remedy = f'set [clocks.NAME] offset_s = {-late:.2g} and clock = "NAME" in [{table}]'
        return f"{table}-clock", f"times of the {table} are {abs(late):.2g} s {word}: {remedy}"

    return say


def _arm(table: str, field: str) -> Say:
    def say(c: Correction) -> tuple[str, str]:
        x, y = getattr(c, field)
        where = f"{x:.1f} m ahead and {y:.1f} m to the left of"
        point, remedy = {
            "odometry": ("the point that the odometry measures", f"set odometry.lever_arm_m = [{x:.1f}, {y:.1f}, 0]"),
            "reference": ("the reference's antenna", f"set reference.lever_arm_m = [{x:.1f}, {y:.1f}, 0]"),
            "array": (
                "the point that odometry and reference describe",
                f"set lever_arm_m = [{x:.1f}, {y:.1f}, 0] in [odometry] and [reference]",
            ),
        }[table]
        return "lever-arm", f"the array sits {where} {point}: {remedy}"

    return say


def _reference(c: Correction) -> tuple[str, str]:
    if c.mirrored:
        return "swapped-axes", (
            "x and y of the reference are swapped (north taken for east): exchange x_m and y_m, or say "
            'axes = "north-east-down"'
        )
    known = {
        FOOT_M: ("reference-unit", 'the reference is in feet, taken for metres: say unit = "ft" for x_m and y_m'),
        1 / FOOT_M: ("reference-unit", 'the reference is in metres, taken for feet: say unit = "m" for x_m and y_m'),
        1e3: ("reference-unit", 'the reference is in km: say unit = "km" for x_m and y_m'),
        1e-2: ("reference-unit", 'the reference is in cm: say unit = "cm" for x_m and y_m'),
        1e-3: ("reference-unit", 'the reference is in mm: say unit = "mm" for x_m and y_m'),
    }  # fmt: skip
    return _named(
        c.reference, known, ("reference-unit", "the reference fits if it is multiplied by {:.3g}: a wrong unit")
    )


def _scale_harmless(field: str) -> Callable[[Correction], bool]:
    return lambda c: getattr(c, field) > 0.0 and bool(abs(np.log(getattr(c, field))) < SCALE)


def _arms(table: str) -> Explanation:
    field = f"{table}_arm_m"
    return Explanation(
        [Correction().having(field, arm) for arm in ARMS_M],
        _arm(table, field),
        lambda c: bool(np.hypot(*getattr(c, field)) < ARM_M),
        _turned(field),
    )


def _clocks(table: str) -> Explanation:
    field = f"{table}_late_s"
    return Explanation(
        [Correction().having(field, late) for late in LATE_S],
        _late(table, field),
        lambda c: abs(getattr(c, field)) < LATE,
        _moved(field, 0.5),
        least=0.75,
    )


def _factors(field: str, values: Sequence[float], say: Say) -> list[Explanation]:
    """Return known factors, each an explanation of its own, and any other one."""
    known = [Correction().having(field, value) for value in values]
    other = [*known, *(Correction().having(field, value) for value in SCALES)]
    alone = [Explanation([c], say) for c in known]
    return [*alone, Explanation(other, say, _scale_harmless(field), _scaled(field))]


ZEROS = [np.radians(z) for z in (30, 60, 90, 120, 150, -30, -60, -90, -120, -150)]
EXPLANATIONS = (
    Explanation([Correction(speed=-1.0)], _speed),
    *_factors("speed", (1 / 3.6, 3.6, FOOT_M, 1e-3, 1e-2), _speed),
    Explanation([Correction(yaw_rate=-1.0)], _yaw_rate),
    *_factors("yaw_rate", (DEGREE, -DEGREE, 1 / DEGREE), _yaw_rate),
    Explanation([Correction(yaw_rate=-1.0, side=-1.0)], _yaw_rate),
    _clocks("odometry"),
    _clocks("measurements"),
    _clocks("reference"),
    _arms("odometry"),
    _arms("array"),
    _arms("reference"),
    Explanation([Correction(azimuth=-1.0)], _azimuth),
    Explanation(
        [Correction(azimuth=sign, azimuth_zero_rad=zero) for sign in (1.0, -1.0) for zero in ZEROS]
        + [Correction(azimuth=-1.0, azimuth_zero_rad=np.pi)],
        _azimuth,
        lambda c: c.azimuth > 0.0 and abs(c.azimuth_zero_rad) < ZERO_RAD,
        _moved("azimuth_zero_rad", np.radians(10.0)),
    ),
    *_factors("distance", (NANOSECOND_M, 1 / NANOSECOND_M, 0.5, 2.0, 1e3, 1e-3, 1e-2), _distance),
    Explanation(
        [Correction(distance_zero_m=shift) for shift in SHIFTS_M],
        _shift,
        lambda c: abs(c.distance_zero_m) < SHIFT_M,
        _moved("distance_zero_m", 4.0),
    ),
    *_factors("reference", (FOOT_M, 1 / FOOT_M, 1e3, 1e-3, 1e-2), _reference),
    Explanation([Correction(mirrored=True)], _reference),
)
