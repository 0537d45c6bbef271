"""`cellslam record` and `cellslam replay`."""

from __future__ import annotations

import sys
import tomllib
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks import trials
from cellslam.benchmarks.bars import bars
from cellslam.benchmarks.cli import DONE
from cellslam.benchmarks.cli_run import Job, note_left_out, report, work_off
from cellslam.benchmarks.output import Folder, check_file, check_folder
from cellslam.scenarios.loading import from_tables, load
from cellslam.scenarios.options import resolve, with_options
from cellslam.scenarios.overrides import apply, parse_all
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.scenarios.model import Scenario


def record(arguments: Namespace) -> int:
    """Carry out `cellslam record`."""
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    resolve(scenario.estimator, (), overrides)
    trials.check_counts(1, arguments.seed)
    if arguments.trial < 0:
        raise InputError(f"trial = {arguments.trial}: must be 0 or more")
    path = Path(arguments.out)
    check_file(path)
    with bars(arguments.quiet) as progress:
        recording = trials.record(scenario, arguments.seed, arguments.trial, progress)
        recording.save(path)
    if not arguments.quiet:
        sys.stderr.write(
            f"{path}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
            f"{len(recording.measurements)} measurements\n"
        )
    return DONE


def replay(arguments: Namespace) -> int:
    """Carry out `cellslam replay`."""
    overrides = estimator_overrides(arguments)
    path = Path(arguments.file)
    recording = Recording.load(path)
    if arguments.align and recording.truth is None and recording.reference is None:
        raise InputError(f"--align: {path} has neither truth nor reference to align to; leave the option out")
    origin = Origin.of(recording, path)
    seed = origin.seed if arguments.seed is None else arguments.seed
    trials.check_counts(1, seed)
    tables = apply({"estimator": origin.options}, overrides)["estimator"]
    requests = resolve(tables, arguments.estimators or trials.DEFAULT_ESTIMATORS, overrides)
    note_left_out(arguments)
    out = Path(arguments.out or f"results/replay-{path.stem}")
    check_folder(out)
    scenario = with_options(origin.scenario, requests) if origin.scenario is not None else None
    job = Job(arguments, scenario, origin.name, requests, 1, Folder(out))
    with bars(arguments.quiet) as progress:

        def only() -> Iterator[trials.Trial]:
            align = arguments.align
            yield trials.score_recording(recording, origin.name, requests, origin.trial, seed, progress, align)

        interrupted = work_off(job, only(), progress)
    return report(job, interrupted)


def estimator_overrides(arguments: Namespace) -> dict[str, Any]:
    """Return the options of `--options` and `--set` by dotted key; those of `--set` win. Raises InputError."""
    sets = parse_all(arguments.sets)
    foreign = [key for key in sets if not key.startswith("estimator.")]
    if foreign:
        raise InputError(f"--set {foreign[0]}: a recording is as it is; replay can set 'estimator.NAME.key' only")
    return (_options_of(Path(arguments.options)) if arguments.options else {}) | sets


def _options_of(path: Path) -> dict[str, Any]:
    try:
        tables = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"--options {path}: not TOML ({error}); correct it there") from error
    except OSError as error:
        raise InputError(f"--options {path}: cannot be read ({error.strerror})") from error
    estimators = tables.get("estimator")
    other = next((name for name in tables if name != "estimator"), "")
    if other or not isinstance(estimators, Mapping) or not all(isinstance(t, Mapping) for t in estimators.values()):
        what = f"has '{other}'" if other else "has no table [estimator.NAME]"
        raise InputError(f"--options {path}: {what}; it takes tables [estimator.NAME] alone, as fit-noise prints them")
    return {f"estimator.{name}.{key}": value for name, table in estimators.items() for key, value in table.items()}


@dataclass(frozen=True)
class Origin:
    """What a recording says about where it comes from; a measured one may say nothing."""

    name: str
    seed: int
    trial: int
    options: Mapping[str, Any]
    scenario: Scenario | None

    @staticmethod
    def of(recording: Recording, path: Path) -> Origin:
        """Read the provenance of a recording loaded from `path`."""
        said = recording.provenance
        tables = said.get("scenario")
        if not isinstance(tables, Mapping):
            return Origin(path.stem, _count(said.get("seed")), _count(said.get("trial")), {}, None)
        try:
            scenario = from_tables(tables)
        except InputError:
            # Written by another version of the models: estimators need its options only, not its world.
            scenario = None
        name, options = str(tables.get("name", path.stem)), tables.get("estimator", {})
        return Origin(name, _count(said.get("seed")), _count(said.get("trial")), options, scenario)


def _count(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0
