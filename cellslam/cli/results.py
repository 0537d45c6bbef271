"""What `run` and `replay` leave of their trials: rows on stdout, notes on stderr, and a folder of files."""

from __future__ import annotations

import json
import shlex
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.tables.trials_table import bound_row, results_table
from cellslam.benchmarks.trials.output_files import file_name, write_text, write_tum, writing
from cellslam.cli.arguments import DONE, FAILED, INTERRUPTED
from cellslam.cli.between_drives import save
from cellslam.cli.output import console, note
from cellslam.cli.time_spent import TimeSpent
from cellslam.slam import registry

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.trials import Trial
    from cellslam.scenarios.estimator_options import Request
    from cellslam.scenarios.scenario import Scenario
    from cellslam.sim.progress import Progress
    from cellslam.sim.world import World

PIPE_WIDTH = 120
SUMMARY = "summary.json"
OF_TRIALS = (
    "trajectory-*.tum", "error-*.txt", "map.png", "error.png", "associations.png", "clock_offsets.png",
    "calibration-*.png", "rays*.png", "rays.html",
)  # fmt: skip


@dataclass
class Results:
    """What one command does, and what it has done so far; `folder` is written trial by trial.

    `open_store`: gives what keeps trials as a sweep does, once the first one is there; None: nothing does.
    """

    arguments: Namespace
    name: str
    requests: Sequence[Request]
    folder: Path
    trials: int = 1
    scenario: Scenario | None = None
    open_store: Callable[[], Callable[[Trial], None] | None] = lambda: None
    rows: list[dict[str, Any]] = field(default_factory=list)
    bounds: list[dict[str, Any]] = field(default_factory=list)
    first: Trial | None = None
    keep: Callable[[Trial], None] | None = None
    unsaved: bool = False
    time_spent: TimeSpent = field(default_factory=TimeSpent)

    def note(self, text: str) -> None:
        """Say something, if it is something, on stderr, unless --quiet."""
        note(self.arguments, text)

    @property
    def command(self) -> str:
        """The command line."""
        return shlex.join(["cellslam", *self.arguments.words])

    def work_off(self, trials: Iterator[Trial], progress: Progress) -> bool:
        """Go through the trials, writing what each leaves; return whether the user interrupted."""
        try:
            for trial in trials:
                self._add(trial)
            if self.first is not None and not self.arguments.no_figures:
                self._draw(self.first, progress)
        except KeyboardInterrupt:
            if self.rows:
                self._write_summary()
            return True
        return False

    def report(self, interrupted: bool) -> int:
        """Print the rows and return the exit status."""
        if self.arguments.json:
            lines = ",\n".join(json.dumps(row, allow_nan=False) for row in self.rows)
            sys.stdout.write(f"[\n{lines}\n]\n" if self.rows else "[]\n")
        elif self.rows:
            out = console(PIPE_WIDTH)
            oracles = frozenset(request.name for request in self.requests if request.oracle)
            out.print(results_table([*self.rows, *self.bounds], self._title(), oracles, out.width))
        if interrupted:
            done = len({row["trial"] for row in self.rows})
            kept = f"{done} of {self.trials} trials are finished and kept in {self.folder}"
            text = kept if done else "no trial was finished and nothing was written"
            sys.stderr.write(f"interrupted: {text}; to do it all, repeat: {self.command}\n")
            return INTERRUPTED
        self.note(f"{self.time_spent.in_words()}\nresults are in {self.folder}")
        return FAILED if self.unsaved or any(row["status"] == "failed" for row in self.rows) else DONE

    def write(self, name: str, text: str) -> None:
        """Write a text file into the folder."""
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / name, text)

    def _add(self, trial: Trial) -> None:
        if self.first is None:
            self._clear()
        self.rows.extend(outcome.row for outcome in trial.outcomes)
        self.bounds.extend([] if trial.drive.bound is None else [bound_row(trial.drive.bound)])
        self.note(f"without the bound: {trial.drive.unbound}" if trial.drive.unbound else "")
        self._write_trial(trial)
        if self.first is None:
            self.first, self.keep = trial, self.open_store()
            if self.scenario is not None:
                self.write("scenario.toml", self.scenario.toml())
        if self.keep is not None:
            self.keep(trial)
        self._write_summary()
        for outcome in trial.outcomes:
            of = f"trial {trial.number}, {outcome.row['estimator']}"
            if outcome.row["status"] == "failed":
                sys.stderr.write(f"{of} failed: {outcome.row['error']}\n")
            for remark in outcome.result.remarks if outcome.result is not None else ():
                self.note(f"{of}: {remark}")
        for problem in save(self.arguments, self.requests, trial):
            self.unsaved = True
            self.note(problem)

    def _clear(self) -> None:
        """Remove the files that an earlier run left here, which would stand beside another summary; its rows stay."""
        with writing(self.folder):
            if (self.folder / SUMMARY).exists():
                for pattern in OF_TRIALS:
                    for file in self.folder.glob(pattern):
                        file.unlink()

    def _write_trial(self, trial: Trial) -> None:
        """Write trajectories (TUM), the truth's too, and the traceback of each estimator that failed."""
        recording, suffix = trial.drive.recording, f"-{trial.number}" if self.trials > 1 else ""
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            if recording is not None and recording.truth is not None:
                write_tum(self.folder / f"trajectory-truth{suffix}.tum", recording.time_s, recording.truth.poses)
            for outcome in trial.outcomes:
                name = f"{file_name(outcome.row['estimator'])}{suffix}"
                if outcome.result is not None and recording is not None:
                    write_tum(self.folder / f"trajectory-{name}.tum", recording.time_s, outcome.result.poses)
                if outcome.traceback:
                    write_text(self.folder / f"error-{name}.txt", outcome.traceback)

    def _write_summary(self) -> None:
        recording = self.first.drive.recording if self.first else None
        provenance = {} if recording is None else recording.provenance
        about = {
            "command": self.command,
            "scenario": self.name,
            "trials": self.trials,
            "versions": provenance.get("versions", {}),
            "resolved": self.scenario.resolved if self.scenario is not None else None,
        }
        self.write(SUMMARY, json.dumps({**about, "rows": self.rows}, indent=1) + "\n")

    def _draw(self, trial: Trial, progress: Progress) -> None:
        """Draw the figures of a trial, and its rays where they were asked for."""
        from cellslam.benchmarks.figures.trial.trial_figures import draw_all

        world = self._world_of(trial)
        results = {o.row["estimator"]: o.result for o in trial.outcomes if o.result is not None}
        if trial.drive.recording is not None and results:
            city = world.scene.city if world else None
            with writing(self.folder):
                asked = bool(self.arguments.calibration or self.arguments.save_calibration)
                draw_all(city, trial.drive.recording, results, trial.drive.bound, self.folder, progress, None, asked)
        if world is not None and getattr(self.arguments, "rays", False):
            from cellslam.benchmarks.report.city_page import draw_rays

            draw_rays(world, self.folder)

    def _world_of(self, trial: Trial) -> World | None:
        """Return the world of a trial, for the maps; None for a recording without scenario."""
        if self.scenario is None or trial.drive.recording is None:
            return None
        from cellslam.sim.world import prepare

        return prepare(self.scenario.world, int(trial.drive.recording.provenance.get("seed", 0)), trial.number)

    def _title(self) -> str:
        row = next((row for row in self.rows if row["snapshots"] is not None), None)
        if row is None:
            return f"{self.name}, seed {self.rows[0]['seed']}: no world could be made"
        many = f"medians of {self.trials} trials, " if self.trials > 1 else ""
        length = f", {row['distance_m']:.0f} m" if row["distance_m"] is not None else ""
        drive = f"{row['snapshots']} snapshots, {row['duration_s']:.1f} s{length}"
        drive += ", estimates ALIGNED to the truth" if "alignment" in row else ""
        return f"{self.name}, seed {row['seed']}: {many}{drive}"


def left_out(arguments: Namespace) -> str:
    """Return lines about the estimators that `all` does not stand for, unless they are asked for by name."""
    if registry.ALL not in arguments.estimators:
        return ""
    names = registry.left_out().items()
    return "\n".join(f"left out of all: {name} ({why})" for name, why in names if name not in arguments.estimators)
