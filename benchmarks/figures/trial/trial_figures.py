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
    from cellslam.sim.city import City


def draw_all(
    city: City | None,
    recording: Recording,
    results: Mapping[str, TrialResult],
    bound: BoundResult | None,
    out_dir: str | Path,
    progress: Progress = silent,
    formats: Sequence[str] = ("png",),
) -> list[Path]:
    """Draw every figure that applies, write each as `out_dir`/NAME.FORMAT, and return the paths written.

    `map` needs truth or a result; `error` needs truth; `associations` needs measurements; `clock_offsets` a
    result with offsets, `calibration-ESTIMATOR` one with the array's calibration. `city` None: a map without
    buildings. `formats`: what matplotlib writes, such as png and pdf.
    """
    from matplotlib.figure import Figure

    from cellslam.benchmarks.figures import style
    from cellslam.benchmarks.figures.trial import array_calibration as array
    from cellslam.benchmarks.figures.trial import associations
    from cellslam.benchmarks.figures.trial import clock_offsets as clock
    from cellslam.benchmarks.figures.trial import position_error as error
    from cellslam.benchmarks.figures.trial import trial_map as overview

    drawings: dict[str, Callable[[Figure], bool]] = {
        "map": lambda figure: overview.draw(figure, city, recording, results),
        "error": lambda figure: error.draw(figure, recording, results, bound),
        "associations": lambda figure: associations.draw(figure, recording, results),
        "clock_offsets": lambda figure: clock.draw(figure, recording, results),
    }
    for name, calibration in ((name, r.calibration) for name, r in results.items() if r.calibration is not None):
        drawings[f"calibration-{file_name(name)}"] = partial(
            array.draw, calibration=calibration, provenance=recording.provenance
        )
    folder, written = Path(out_dir), []
    folder.mkdir(parents=True, exist_ok=True)
    with style.context(), progress("figures", len(drawings)) as advance:
        for name, drawing in drawings.items():
            figure = Figure(layout="constrained")
            if drawing(figure):
                written += [style.save(figure, folder / f"{name}.{format_}") for format_ in formats]
            advance(1)
    return written
