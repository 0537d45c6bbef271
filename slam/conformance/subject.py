"""What the conformance kit checks and on which drive: estimator, options, snapshots as given and changed ones; and what
an answer must look like."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from importlib.resources import as_file, files
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import Estimate, Setup, Snapshot, Step, setup_of, steps_of

SHORT = 60  # snapshots of most checks: 4.5 s


class ConformanceError(AssertionError):
    """Something that an estimator does wrong; the text says what, and what to do about it."""


def finding(what: str, remedy: str) -> ConformanceError:
    """Return the error that says what is wrong and how to fix it."""
    return ConformanceError(f"{what}; to fix: {remedy}")


def require(ok: bool, what: str, remedy: str) -> None:
    """Raise ConformanceError unless `ok`."""
    if not ok:
        raise finding(what, remedy)


def require_same(a: Sequence[Estimate], b: Sequence[Estimate], what: str, remedy: str) -> None:
    """Raise ConformanceError where two series of answers differ, in any bit."""
    for t, (x, y) in enumerate(zip(a, b, strict=True)):
        for field in fields(Estimate):
            same = pickle.dumps(_plain(getattr(x, field.name))) == pickle.dumps(_plain(getattr(y, field.name)))
            require(same, f"{what} ({field.name} of snapshot {t})", remedy)


def _plain(value: Any) -> Any:
    """Return plain data that compare and pickle by value."""
    if value is None or isinstance(value, (int, float)):
        return value
    if isinstance(value, (np.ndarray, list, tuple)):
        array = np.asarray(value)
        return array.dtype.str, array.shape, array.tobytes()
    return tuple(_plain(getattr(value, field.name)) for field in fields(value))


def check_answer(answer: Any, snapshot: Snapshot, setup: Setup) -> None:
    """Raise ConformanceError unless a step has answered with an Estimate of the right shapes, all finite."""
    what = f"step returned {type(answer).__name__}"
    require(isinstance(answer, Estimate), what, "return cellslam.slam.api.Estimate(pose, covariance)")
    check_array("pose", answer.pose, (6,))
    check_array("covariance", answer.covariance, (6, 6))
    for name in ("clock_offset_m", "clock_offset_variance_m2"):
        if getattr(answer, name) is not None:
            check_array(name, getattr(answer, name), (len(setup.sites),))
    if answer.association is not None:
        check_array("association", answer.association, (len(snapshot),))
        ids = np.asarray(answer.association)
        proper = np.issubdtype(ids.dtype, np.integer) and bool((ids >= -1).all())
        require(proper, "association holds more than whole numbers from -1", "give a VT's id, or -1 for none")
    each = {
        "vts": {"link": (), "position_m": (3,), "covariance": (3, 3)},
        "walls": {"azimuth_rad": (), "distance_m": (), "covariance": (2, 2), "extent_m": (2,)},
    }
    for table, columns in each.items():
        if (found := getattr(answer, table)) is not None:
            for name, shape in columns.items():
                check_array(f"{table}.{name}", getattr(found, name), (len(found.id), *shape))


def check_array(name: str, value: Any, shape: tuple[int, ...]) -> None:
    """Raise ConformanceError unless `value` has this shape and is finite."""
    array = np.asarray(value)
    require(array.shape == shape, f"{name} has shape {array.shape}", f"its shape is {shape}")
    finite = np.issubdtype(array.dtype, np.number) and bool(np.isfinite(array).all())
    require(finite, f"{name} is not finite", "guard divisions and logarithms; skip what was not measured")


def check_covariance(what: str, matrix: Floats, remedy: str) -> None:
    """Raise ConformanceError unless a matrix (n, n) is symmetric without negative eigenvalues.

    In any units: to 1e-9 of its largest element.
    """
    scale = max(float(np.abs(matrix).max()), 1e-12)
    require(float(np.abs(matrix - matrix.T).max()) <= 1e-9 * scale, f"{what} is not symmetric", remedy)
    least = float(np.linalg.eigvalsh(matrix)[0])
    require(least >= -1e-9 * scale, f"{what} has the eigenvalue {least:.3g}", remedy)


@dataclass(frozen=True)
class Subject:
    """The estimator class to be checked, its options, and the drive: a recording with truth."""

    estimator: type[Any]
    options: Any
    recording: Recording

    def new(self) -> Any:
        """Return a new instance."""
        return self.estimator(self.options)

    def warm_up(self) -> None:
        """Let the estimator compile."""
        compile_now = getattr(self.new(), "warm_up", None)
        if callable(compile_now):
            compile_now()

    def setup(self) -> Setup:
        """Return what the runner gives: truth for a declared oracle alone, steps for who declares to need the future.
        Writable copies, to see who writes."""
        setup: Setup = writable(setup_of(self.recording, bool(getattr(self.estimator, "requires_truth", False))))
        foresees = bool(getattr(self.estimator, "requires_future", False))
        return replace(setup, future=tuple(self.steps())) if foresees else setup

    def steps(self, count: int | None = SHORT) -> list[Step]:
        """Return interval, odometry and snapshot of the first `count` snapshots, as writable copies."""
        return [(dt, velocity.copy(), writable(snapshot)) for dt, velocity, snapshot in self._every[:count]]

    @cached_property
    def _every(self) -> list[Step]:
        return steps_of(self.recording)


@cache
def tiny_drive() -> Recording:
    """Return the drive of the checks: one trial of the preset `tiny`, stored (400 snapshots, 6 links, 2 sites)."""
    with as_file(files("cellslam.slam.conformance") / "conformance_drive.h5") as path:
        return Recording.load(path)


def drive(estimator: Any, setup: Setup, steps: Sequence[Step], seed: int = 0) -> list[Estimate]:
    """Return copies of an estimator's answers over `steps`, from a start with the generator of `seed`."""
    estimator.start(with_future(setup, steps), np.random.default_rng(seed))
    return [copied(estimator.step(*step)) for step in steps]


def with_future(setup: Setup, steps: Sequence[Step]) -> Setup:
    """Return a setup whose future, where it has one, is `steps`."""
    return setup if setup.future is None else replace(setup, future=tuple(steps))


def writable(value: Any) -> Any:
    """Return a dataclass with its arrays copied, at any depth, and writable."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if hasattr(value, "__dataclass_fields__"):
        return replace(value, **{f.name: writable(getattr(value, f.name)) for f in fields(value)})
    return value


def copied(answer: Any) -> Estimate:
    """Return a copy of an answer; raise ConformanceError where it is no Estimate."""
    what = f"step returned {type(answer).__name__}"
    require(isinstance(answer, Estimate), what, "return cellslam.slam.api.Estimate(pose, covariance)")
    copy: Estimate = writable(answer)
    return copy


def merged(steps: Sequence[Step], kept: Sequence[int]) -> list[Step]:
    """Return the snapshots `kept` (ascending, the first is 0) alone, with mean odometry from each to the next."""
    out = [steps[0]]
    for before, now in pairwise(kept):
        span = steps[before + 1 : now + 1]
        velocity: Floats = np.mean([u for _, u, _ in span], axis=0)
        out.append((sum(dt for dt, _, _ in span), velocity, replace(steps[now][2], index=len(out))))
    return out


def taken(snapshot: Snapshot, rows: NDArray[Any]) -> Snapshot:
    """Return a snapshot with the measurements `rows` (n,) alone, in that order."""
    columns = [f.name for f in fields(Snapshot) if f.name != "index"]
    values: dict[str, Any] = {name: getattr(snapshot, name) for name in columns}
    chosen: dict[str, Any] = {name: None if v is None else v[rows] for name, v in values.items()}
    return replace(snapshot, **chosen)


def without(step: Step) -> Step:
    """Return a step with an empty snapshot."""
    return step[0], step[1], taken(step[2], np.empty(0, np.int64))


def with_holes(snapshot: Snapshot, column: str, rng: np.random.Generator) -> Snapshot:
    """Return a snapshot with NaN in a third of one column."""
    values: Floats = getattr(snapshot, column)
    holed: dict[str, Any] = {column: np.where(rng.random(len(values)) < 1 / 3, np.nan, values)}
    return replace(snapshot, **holed)


def run_checked(subject: Subject, steps: Sequence[Step], situation: str, remedy: str) -> None:
    """Drive a new instance over `steps`; raise ConformanceError for whatever goes wrong in this situation."""
    try:
        setup, estimator = subject.setup(), subject.new()
        estimator.start(with_future(setup, steps), np.random.default_rng(0))
        for step in steps:
            check_answer(estimator.step(*step), step[2], setup)
    except ConformanceError as error:
        raise ConformanceError(f"{situation}: {str(error).split('; to fix: ')[0]}; to fix: {remedy}") from error
    except Exception as error:
        raise finding(f"{situation}: {type(error).__name__}: {error}", remedy) from error
