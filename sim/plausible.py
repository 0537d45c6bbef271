"""The one table of plausible values: what is beyond the possible is refused, what is beyond the usual is remarked."""

from __future__ import annotations

from dataclasses import dataclass

from cellslam.sim.errors import InputError


@dataclass(frozen=True)
class Range:
    """Least and greatest value of a quantity in `unit`: as it usually is, as it possibly is, and `why` no more."""

    unit: str
    usual: tuple[float, float]
    possible: tuple[float, float]
    why: str

    def check(self, value: float, what: str) -> None:
        """Raise InputError, naming `what` it is, for a value beyond the possible."""
        if not self.possible[0] <= value <= self.possible[1]:
            raise self.impossible(value, what)

    def impossible(self, value: float, what: str) -> InputError:
        """Return the error for a value beyond the possible."""
        least, most = self.possible
        return InputError(f"{what}: {value:.6g} {self.unit} cannot be: must be {least:g} to {most:g} ({self.why})")


def _within(most: float) -> tuple[float, float]:
    return -most, most


RANGES = {
    "time": Range(
        "s", _within(1e10), _within(1e11),
        "seconds since 1970 are 2e9, since the year 0 6e10; milliseconds since 1970 are 2e12",
    ),
    "interval": Range(
        "s", (1e-6, 3600.0), (1e-9, 1e6),
        "a clock of a receiver tells no less than a nanosecond apart, and no drive pauses for twelve days",
    ),
    "distance": Range(
        "m", _within(1e5), _within(3.1e9),
        "the largest cells reach 100 km; frame numbers repeat after 10.24 s, in which light goes 3.07e9 m",
    ),
    "position": Range(
        "m", _within(1e7), _within(1e8),
        "map grids count up to 1e7 m, and up to 6e7 m where the number of the zone is put before",
    ),
    "angle": Range(
        "rad", _within(1e3), _within(1e6),
        "a yaw that is not wrapped grows with each turn; 1e3 rad are 160 turns one way, 1e6 more than a drive has",
    ),
    "speed": Range("m/s", _within(150.0), _within(3e8), "trains reach 150 m/s, light 3e8 m/s"),
    "turn rate": Range("rad/s", _within(10.0), _within(1e5), "gyros of cars measure up to 10 rad/s; no rotor has 1e5"),
    "clock rate": Range(
        "m/s", _within(3e4), _within(3e8), "an oscillator off by 1e-4 drifts by 3e4 m/s; one by 3e8 m/s stands still",
    ),
    "share": Range("1", _within(1.0), _within(1e3), "a wheel's scale is known to a few hundredths"),
    "SNR": Range("dB", (-60.0, 100.0), _within(300.0), "thermal noise and the loudest transmitter are 200 dB apart"),
    "height": Range("m", (0.0, 900.0), (0.0, 2e3), "the highest building has 830 m, of a ground that is at 0"),
}  # fmt: skip
