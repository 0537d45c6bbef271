"""The figures of one trial, as in the paper's section V: map, error, associations, clock offsets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import file_name
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.figures.style import Drawing
    from cellslam.sim.city import City


def drawings(
    city: City | None, recording: Recording, results: Mapping[str, TrialResult], bound: BoundResult | None
) -> dict[str, Drawing]:
    """Return the figures of a trial by name: functions that draw into a Figure, False where one does not apply.

    `map` needs truth or a result; `error` needs truth; `associations` needs measurements; `clock_offsets` a
    result with offsets, `calibration-ESTIMATOR` one with the array's calibration. `city` None: a map without
    buildings.
    """
    from cellslam.benchmarks.figures.trial import array_calibration, over_time, trial_map

    out: dict[str, Drawing] = {
        "map": lambda figure: trial_map.draw(figure, city, recording, results),
        "error": lambda figure: over_time.draw_error(figure, recording, results, bound),
        "associations": lambda figure: over_time.draw_associations(figure, recording, results),
        "clock_offsets": lambda figure: over_time.draw_clock_offsets(figure, recording, results),
    }
    for name, calibration in ((name, r.calibration) for name, r in results.items() if r.calibration is not None):
        draw = partial(array_calibration.draw, calibration=calibration, provenance=recording.provenance)
        out[f"calibration-{file_name(name)}"] = draw
    return out


def draw_all(
    city: City | None,
    recording: Recording,
    results: Mapping[str, TrialResult],
    bound: BoundResult | None,
    out_dir: str | Path,
    progress: Progress = silent,
    formats: Sequence[str] = ("png",),
    names: Sequence[str] | None = None,
) -> list[Path]:
    """Draw every figure that applies, write each as `out_dir`/NAME.FORMAT, and return the paths written.

    `names`: of the figures to draw (None: all).
    """
    from cellslam.benchmarks.figures.style import write_all

    every = drawings(city, recording, results, bound)
    return write_all({name: every[name] for name in names or every}, out_dir, formats, progress)
