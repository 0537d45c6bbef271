"""The figures of one trial, as in the paper's section V: map, error, associations, clock offsets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import file_name
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cellslam.sim.city import City


Drawing = Callable[["Figure"], bool]


def drawings(
    city: City | None, recording: Recording, results: Mapping[str, TrialResult], bound: BoundResult | None
) -> dict[str, Drawing]:
    """Return the figures of a trial by name: functions that draw into a Figure, False where one does not apply.

    `map` needs truth or a result; `error` needs truth; `associations` needs measurements; `clock_offsets` a
    result with offsets, `calibration-ESTIMATOR` one with the array's calibration. `city` None: a map without
    buildings.
    """
    from cellslam.benchmarks.figures.trial import array_calibration as array
    from cellslam.benchmarks.figures.trial import associations
    from cellslam.benchmarks.figures.trial import clock_offsets as clock
    from cellslam.benchmarks.figures.trial import position_error as error
    from cellslam.benchmarks.figures.trial import trial_map as overview

    out: dict[str, Drawing] = {
        "map": lambda figure: overview.draw(figure, city, recording, results),
        "error": lambda figure: error.draw(figure, recording, results, bound),
        "associations": lambda figure: associations.draw(figure, recording, results),
        "clock_offsets": lambda figure: clock.draw(figure, recording, results),
    }
    for name, calibration in ((name, r.calibration) for name, r in results.items() if r.calibration is not None):
        out[f"calibration-{file_name(name)}"] = partial(
            array.draw, calibration=calibration, provenance=recording.provenance
        )
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

    `formats`: what matplotlib writes, such as png and pdf. `names`: of the figures to draw (None: all).
    """
    from matplotlib.figure import Figure

    from cellslam.benchmarks.figures import style

    every = drawings(city, recording, results, bound)
    every = every if names is None else {name: every[name] for name in names}
    folder, written = Path(out_dir), []
    folder.mkdir(parents=True, exist_ok=True)
    with style.context(), progress("figures", len(every)) as advance:
        for name, drawing in every.items():
            figure = Figure(layout="constrained")
            if drawing(figure):
                written += [style.save(figure, folder / f"{name}.{format_}") for format_ in formats]
            advance(1)
    return written
