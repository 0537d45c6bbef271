"""The preset `tiny` cut to 7.5 s: for tests of what is around a drive, to which its length is nothing."""

from __future__ import annotations

SET = {"vehicle.distance_m": 5, "vehicle.duration_s": 7.5, "vehicle.stops": 0, "vehicle.stand_first_s": 0}
SHORT = tuple(word for key, value in SET.items() for word in ("--set", f"{key}={value}"))
