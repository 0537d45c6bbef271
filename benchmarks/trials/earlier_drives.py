"""What was before a drive: the map that estimators begin with, from a file or from earlier drives of its sequence.

The drive of a trial is the last of its sequence, so that one world is met after any number of drives; the earlier ones
have the trial's city, route and sites, and all else of trials that nothing else asks for. They start at a known pose,
which gives their map its frame: start deviations that are given hold for the last drive alone, so that a vehicle may be
put down anywhere in a map that is right. Where several cars drove before it, each begins with the map that all of them
left together.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.scenario import MapConfig, Scenario
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Recording
from cellslam.slam.model.map_joining import join
from cellslam.slam.model.vt_map import VtMap

if TYPE_CHECKING:
    from cellslam.benchmarks.bound.cramer_rao import BoundResult

APART = 1_000_000  # from the trial of a drive to that of the next one of its sequence
MOST_DRIVES = 100  # of a sequence: from the number of a car's drive to that of the next car's


def uses_maps(request: Request) -> bool:
    """Return whether an estimator begins with a map and leaves one."""
    return not request.external and callable(getattr(request.estimator, "vt_map", None))


@dataclass(frozen=True)
class Before:
    """What was before the drive of a trial; without a scenario its recording is all that is known of it."""

    config: MapConfig
    scenario: Scenario | None = None
    seed: int = 0
    trial: int = 0

    def known(self, request: Request) -> VtMap | None:
        """Return the map that an estimator begins the drive with; None: it has none, or cannot use it.

        Passes on whatever an earlier drive raises.
        """
        if self.scenario is None or self.config.drives == 1 or not uses_maps(request):
            return self.config.known if uses_maps(request) or request.external else None
        options = None if request.options is None else request.options.model_dump_json()
        key = (self._place(), self.seed, self.trial)
        return _left(*key, _Hashed(request, f"{request.name} {options}"), self.config.drives - 1)

    def bound(self, recording: Recording, progress: Progress = silent) -> BoundResult:
        """Return the bound of the drive: with earlier drives, that of a map which they left.

        Raises InputError where a map is known of which nothing else is.
        """
        from cellslam.benchmarks.bound.merged_paths import both_bounds
        from cellslam.benchmarks.bound.shared_maps import shared_map_bounds

        if self.config.file is not None:
            raise InputError("the drives that the map is from are not known")
        if self.scenario is None or self.config.drives == 1:
            return both_bounds(recording, progress)
        numbers = [n for drive in range(1, self.config.drives) for n in _numbers(drive, self.config.cars)]
        drives = [_earlier(self._place(), self.seed, self.trial, n) for n in numbers]
        return list(shared_map_bounds([*drives, recording]))[-1]

    def _place(self) -> _Hashed:
        assert self.scenario is not None
        vehicle = self.scenario.vehicle.model_copy(update={"start_std_m": 0.0, "start_std_deg": 0.0})
        one = self.scenario.model_copy(update={"map": self.config.model_copy(update={"drives": 1}), "vehicle": vehicle})
        return _Hashed(one, one.model_dump_json())


@dataclass(frozen=True)
class _Hashed:
    """A value that is the same as another one if its text is."""

    value: Any = field(compare=False)
    text: str


@lru_cache(maxsize=8)
def _earlier(place: _Hashed, seed: int, trial: int, number: int) -> Recording:
    """Return the recording of an earlier drive, the first one being 1."""
    return simulate(place.value, seed, trial + APART * number, place=trial)


def _numbers(drive: int, cars: int) -> range:
    """Return the numbers of the n-th drives of all cars."""
    return range(drive, drive + MOST_DRIVES * cars, MOST_DRIVES)


@lru_cache(maxsize=64)
def _left(place: _Hashed, seed: int, trial: int, request: _Hashed, drives: int) -> VtMap | None:
    """Return the map that so many drives of each car have left to one estimator; one that does not fit those of the
    cars before it is left out."""
    config: MapConfig = place.value.map
    if drives == 0:
        return config.known
    before, whole = _left(place, seed, trial, request, drives - 1), None
    for number in _numbers(drives, config.cars):
        rng = stream(seed, trial + APART * number, Stream.ESTIMATOR)
        found = estimate(_earlier(place, seed, trial, number), request.value, rng, known=before).vt_map
        if whole is None:
            whole = found
        elif found is not None:
            with suppress(InputError):
                whole = join(whole, found).map
    return whole
