"""The folder of results: rows, resolved scenario, trajectories, figures; written trial by trial."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.output_files import file_name, write_text
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cellslam.benchmarks.trials.trials import Trial
    from cellslam.sim.city import City

SUMMARY = "summary.json"
OF_TRIALS = (
    "trajectory-*.tum", "error-*.txt", "map.png", "error.png", "associations.png", "clock_offsets.png",
    "calibration-*.png", "rays*.png", "rays.html",
)  # fmt: skip


@dataclass(frozen=True)
class Folder:
    """Where the results of one command go. `several`: file names carry the number of the trial."""

    path: Path
    several: bool = False

    def clear(self) -> None:
        """Remove the files that an earlier run left here, which would stand beside another summary; its rows stay."""
        with _writing(self.path):
            if (self.path / SUMMARY).exists():
                for pattern in OF_TRIALS:
                    for file in self.path.glob(pattern):
                        file.unlink()

    def write_trial(self, trial: Trial) -> None:
        """Write trajectories (TUM), the truth's too, and the traceback of each estimator that failed."""
        from cellslam.benchmarks.trials.output_files import write_tum

        recording, suffix = trial.recording, f"-{trial.number}" if self.several else ""
        with _writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            if recording is not None and recording.truth is not None:
                write_tum(self.path / f"trajectory-truth{suffix}.tum", recording.time_s, recording.truth.poses)
            for outcome in trial.outcomes:
                name = f"{file_name(outcome.row['estimator'])}{suffix}"
                if outcome.result is not None and recording is not None:
                    write_tum(self.path / f"trajectory-{name}.tum", recording.time_s, outcome.result.poses)
                if outcome.traceback:
                    write_text(self.path / f"error-{name}.txt", outcome.traceback)

    def write_summary(self, rows: Sequence[Mapping[str, Any]], about: Mapping[str, Any]) -> None:
        """Write summary.json: `about` (command, scenario, versions) and the rows so far."""
        with _writing(self.path):
            write_text(self.path / SUMMARY, json.dumps({**about, "rows": list(rows)}, indent=1) + "\n")

    def write_scenario(self, toml: str) -> None:
        """Write the resolved scenario as scenario.toml."""
        with _writing(self.path):
            write_text(self.path / "scenario.toml", toml)

    def write_fit(self, toml: str) -> None:
        """Write what was learnt of the errors as fit.toml."""
        with _writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            write_text(self.path / "fit.toml", toml)

    def draw(self, trial: Trial, city: City | None, progress: Progress = silent) -> list[Path]:
        """Draw the figures of a trial and return their paths."""
        from cellslam.benchmarks.figures.trial.trial_figures import draw_all

        results = {o.row["estimator"]: o.result for o in trial.outcomes if o.result is not None}
        if trial.recording is None or not results:
            return []
        with _writing(self.path):
            return draw_all(city, trial.recording, results, trial.bound, self.path, progress)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: results cannot be written ({error.strerror or error})") from error
