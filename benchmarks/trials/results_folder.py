"""The folder of results: rows, resolved scenario, trajectories, figures; written trial by trial."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cellslam.benchmarks.trials.trials import Trial
    from cellslam.sim.city import City


@dataclass(frozen=True)
class Folder:
    """Where the results of one command go. `several`: file names carry the number of the trial."""

    path: Path
    several: bool = False

    def write_trial(self, trial: Trial) -> None:
        """Write trajectories (TUM), the truth's too, and the traceback of each estimator that failed."""
        from cellslam.benchmarks.trials.tum import write_tum

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
            write_text(self.path / "summary.json", json.dumps({**about, "rows": list(rows)}, indent=1) + "\n")

    def write_scenario(self, toml: str) -> None:
        """Write the resolved scenario as scenario.toml."""
        with _writing(self.path):
            write_text(self.path / "scenario.toml", toml)

    def draw(self, trial: Trial, city: City | None, progress: Progress = silent) -> list[Path]:
        """Draw the figures of a trial and return their paths."""
        from cellslam.benchmarks.figures.trial.trial_figures import draw_all

        results = {o.row["estimator"]: o.result for o in trial.outcomes if o.result is not None}
        if trial.recording is None or not results:
            return []
        with _writing(self.path):
            return draw_all(city, trial.recording, results, trial.bound, self.path, progress)


def check_folder(path: Path) -> None:
    """Raise InputError unless a folder `path` exists or can be made, and can be written. Makes nothing."""
    existing = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not existing.is_dir():
        raise InputError(f"--out {path}: {existing} is a file, not a folder; give another --out")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"--out {path}: no permission to write in {existing}; give another --out")


def check_file(path: Path) -> None:
    """Raise InputError unless a file `path` can be written in a folder that exists. Makes nothing."""
    if path.is_dir():
        raise InputError(f"--out {path}: is a folder; give the name of a file in it")
    if not path.absolute().parent.is_dir():
        raise InputError(f"--out {path}: there is no folder {path.parent}; create it first")
    check_folder(path.absolute().parent)


def file_name(estimator: str) -> str:
    """Return an estimator's name as a part of a file name."""
    return re.sub(r"[^\w.-]", "_", estimator)


def write_text(path: Path, text: str) -> None:
    """Write a text file at once, whatever the text: first a temporary one beside it, which then takes its place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, "utf-8", "backslashreplace")
    temporary.replace(path)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: results cannot be written ({error.strerror or error})") from error
