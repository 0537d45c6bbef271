"""What every estimator must do: each check raises ConformanceError with what is wrong and how to fix it.

`cellslam.slam.conformance` runs them under pytest, `cellslam check-estimator` without it.
"""

from __future__ import annotations

import gc
import pickle
import random
import tracemalloc
from collections.abc import Callable

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.conformance.subject import (
    SHORT,
    Subject,
    check_answer,
    check_array,
    check_covariance,
    copied,
    drive,
    finding,
    merged,
    require,
    require_same,
    run_checked,
    taken,
    with_holes,
    without,
)
from cellslam.slam.dead_reckoning import DeadReckoning

RMSE_FACTOR, RMSE_SLACK_M = 1.5, 1.0
PARTS = 10  # of half a drive, between which memory is compared
KEPT_BYTES_PER_SNAPSHOT = 10_000  # what an estimator may keep: its inputs and its answers, for a smoother
DRIVES, LEAK_BYTES = 3, 40_000  # of SHORT / 2 snapshots; what they may leave behind
REORDERED_SLACK_M, REORDERED_STDS = 0.05, 0.5


def declares_what_it_is(subject: Subject) -> None:
    """Name, oracle flag, options model and methods."""
    cls = subject.estimator
    name = getattr(cls, "name", None)
    require(isinstance(name, str) and bool(name), f"name is {name!r}", 'give the class a name: name = "my-estimator"')
    for flag, what in (("requires_truth", "an oracle"), ("requires_future", "it needs the whole drive beforehand")):
        value = getattr(cls, flag, False)
        require(isinstance(value, bool), f"{flag} is {value!r}", f"make it True ({what}) or leave it out")
    for method in ("start", "step"):
        require(callable(getattr(cls, method, None)), f"there is no method {method}", "see slam.api.Estimator")
    options = getattr(cls, "Options", None)
    if options is not None:
        has = hasattr(options, "model_validate") and hasattr(options, "model_fields")
        require(has, f"Options is {options!r}", "make it a pydantic model, or None")
        extra = options.model_config.get("extra")
        require(
            extra == "forbid",
            "Options takes unknown keys in silence",
            'set model_config = ConfigDict(frozen=True, extra="forbid"), so that a misspelt key is reported',
        )


def answers_have_the_right_shapes(subject: Subject) -> None:
    """Every answer: an Estimate, shapes, finite values, ids of associations."""
    setup, steps = subject.setup(), subject.steps()
    estimator = subject.new()
    estimator.start(setup, np.random.default_rng(0))
    for step in steps:
        check_answer(estimator.step(*step), step[2], setup)
    finish = getattr(estimator, "finish", None)
    final = finish() if callable(finish) else None
    if final is not None:
        check_array("finish()", final, (len(steps), 6))


def same_seed_same_answer(subject: Subject) -> None:
    """A new instance with the same seed, and the same instance started again."""
    steps = subject.steps()
    first = subject.new()
    answers = drive(first, subject.setup(), steps)
    remedy = "draw from the `rng` of start() alone; no time, no set order, no other generator"
    require_same(answers, drive(subject.new(), subject.setup(), steps), "two runs with one seed differ", remedy)
    remedy = "let start() set every variable that step() changes"
    require_same(answers, drive(first, subject.setup(), steps), "a second start() does not begin afresh", remedy)


def leaves_global_randomness_alone(subject: Subject) -> None:
    """Neither reads nor writes `random` and `np.random`; leaves both as they were."""
    steps, kept = subject.steps(), (np.random.get_state(), random.getstate())  # noqa: NPY002
    remedy = "use the `rng` that start() is given instead of `random` and `np.random`"
    try:
        answers = []
        for seed in (1, 2):
            random.seed(seed)
            np.random.seed(seed)  # noqa: NPY002
            before = (pickle.dumps(np.random.get_state()), random.getstate())  # noqa: NPY002
            answers.append(drive(subject.new(), subject.setup(), steps))
            after = (pickle.dumps(np.random.get_state()), random.getstate())  # noqa: NPY002
            require(before == after, "global random state has changed", remedy)
        require_same(answers[0], answers[1], "answers depend on global random state", remedy)
    finally:
        np.random.set_state(kept[0])  # noqa: NPY002
        random.setstate(kept[1])


def leaves_its_input_alone(subject: Subject) -> None:
    """Writes neither to the setup nor to odometry or snapshots."""
    setup, steps = subject.setup(), subject.steps()
    before = pickle.dumps((setup, steps))
    drive(subject.new(), setup, steps)
    require(
        pickle.dumps((setup, steps)) == before,
        "setup, odometry or a snapshot was changed",
        "copy before writing (`setup.start_pose.copy()`); the runner's arrays are read-only",
    )


def answers_stay_as_they_were(subject: Subject) -> None:
    """An answer holds its own arrays, which later steps do not overwrite."""
    estimator = subject.new()
    estimator.start(subject.setup(), np.random.default_rng(0))
    given, kept = [], []
    for step in subject.steps():
        given.append(estimator.step(*step))
        kept.append(copied(given[-1]))
    require_same(given, kept, "an answer changed after it was given", "return copies: Estimate(self.pose.copy(), ...)")


def survives_empty_snapshots(subject: Subject) -> None:
    """No measurement at all: from the start, for a while, and for ever."""
    steps = subject.steps()
    for name, empty in (("first", range(10)), ("middle", range(25, 40)), ("every", range(SHORT))):
        emptied = [without(step) if i in empty else step for i, step in enumerate(steps)]
        run_checked(
            subject, emptied, f"{name} snapshots empty", "a snapshot may have no measurement: len(snapshot) == 0"
        )


def does_not_mind_the_order(subject: Subject) -> None:
    """Measurements of a link come in any order."""
    steps, rng = subject.steps(), np.random.default_rng(1)
    mixed = [(dt, u, taken(s, np.lexsort((rng.random(len(s)), s.link)))) for dt, u, s in steps]
    a, b = (drive(subject.new(), subject.setup(), given)[-1] for given in (steps, mixed))
    apart = float(np.hypot(*(a.pose - b.pose)[:2]))
    limit = REORDERED_SLACK_M + REORDERED_STDS * float(np.sqrt(max(a.covariance[0, 0] + a.covariance[1, 1], 0.0)))
    require(
        apart <= limit,
        f"measurements of a link in another order move the position by {apart:.2f} m (allowed {limit:.2f} m)",
        "associate by what was measured, not by place: the first of a link is not the line of sight",
    )


def survives_missing_components(subject: Subject) -> None:
    """NaN: a component was not measured."""
    steps, rng = subject.steps(), np.random.default_rng(2)
    remedy = "a component may be NaN (not measured): leave it out, or the measurement"
    for name in ("distance_m", "azimuth_rad", "elevation_rad", "snr_db"):
        holed = [(dt, u, with_holes(s, name, rng)) for dt, u, s in steps]
        run_checked(subject, holed, f"{name} NaN in every third measurement", remedy)


def survives_other_intervals(subject: Subject) -> None:
    """The time from one snapshot to the next is not constant."""
    steps = subject.steps()
    uneven = merged(steps, [i for i in range(SHORT) if i % 6 in (0, 3, 5)])
    run_checked(subject, uneven, "intervals of 0.075 to 0.225 s", "use the dt_s of each step")


def pickles(subject: Subject) -> None:
    """Before the start and in the middle of a drive; the copy goes on as the original does."""
    remedy = "keep all state in self; no lambdas, open files or locks; no array that is a view of another one in self"
    steps = subject.steps()
    try:
        estimator = pickle.loads(pickle.dumps(subject.new()))
        drive(estimator, subject.setup(), steps[:20])
        copy = pickle.loads(pickle.dumps(estimator))
    except Exception as error:
        raise finding(f"it cannot be pickled: {type(error).__name__}: {error}", remedy) from error
    both = [[copied(e.step(*step)) for step in steps[20:]] for e in (estimator, copy)]
    require_same(both[0], both[1], "after pickling it goes on differently", remedy)


def covariances_are_positive(subject: Subject) -> None:
    """Pose, offsets, VTs and walls: symmetric, no negative variance; x and y uncertain once the vehicle has moved."""
    remedy = "use the Joseph form or symmetrise: P = (P + P.T) / 2"
    for t, answer in enumerate(drive(subject.new(), subject.setup(), subject.steps())):
        check_covariance(f"snapshot {t}: the pose's covariance", answer.covariance, remedy)
        if answer.clock_offset_variance_m2 is not None:
            least = float(np.min(answer.clock_offset_variance_m2, initial=0.0))
            require(least >= 0, f"snapshot {t}: a clock offset has the variance {least:.3g}", remedy)
        for matrix in () if answer.vts is None else answer.vts.covariance:
            check_covariance(f"snapshot {t}: a VT's covariance", matrix, remedy)
        for matrix in () if answer.walls is None else answer.walls.covariance:
            check_covariance(f"snapshot {t}: a wall's covariance", matrix, remedy)
    last = answer.covariance[:2, :2]
    require(
        float(np.linalg.eigvalsh(last)[0]) > 0.0,
        f"after {SHORT} snapshots the position's covariance is {last.tolist()}",
        "add the odometry's noise (setup.odometry_model) at each step",
    )


def memory_does_not_grow(subject: Subject) -> None:
    """Little is kept per snapshot, and nothing from one drive to the next."""
    whole = subject.steps(None)
    estimator, setup, steps = subject.new(), subject.setup(), merged(whole, range(0, len(whole), 2))
    half = len(steps) // 2
    drive(estimator, setup, steps[:10])
    gc.collect()
    gc.freeze()  # what is there already need not be looked through each time
    tracemalloc.start()
    try:
        estimator.start(setup, np.random.default_rng(0))
        for step in steps[:half]:
            estimator.step(*step)
        held = [_traced()]
        for part in np.array_split(np.arange(half, len(steps)), PARTS):
            for i in part:
                estimator.step(*steps[i])
            held.append(_traced())
        # Memory that is taken or given back at once, as when a map outgrows its arrays, is no leak: hence the median.
        kept = PARTS * float(np.median(np.diff(held))) / (len(steps) - half)
        traced = []
        for _ in range(3):  # what fills a pool once is no leak
            estimator.start(setup, np.random.default_rng(0))
            traced.append(_traced())
            for _ in range(DRIVES):
                drive(estimator, setup, subject.steps(SHORT // 2))
        leaked = int(min(np.diff(traced)))
    finally:
        tracemalloc.stop()
        gc.unfreeze()
    require(
        kept <= KEPT_BYTES_PER_SNAPSHOT,
        f"{kept / 1000:.0f} kB more are held after each snapshot (allowed {KEPT_BYTES_PER_SNAPSHOT // 1000} kB)",
        "bound the map and the history: drop what is not needed",
    )
    require(
        leaked <= LEAK_BYTES,
        f"{DRIVES} drives of {SHORT // 2} snapshots leave {leaked / 1000:.0f} kB behind",
        "keep state in self and reset it in start(); no lists in the class or the module",
    )


def does_no_harm(subject: Subject) -> None:
    """On the tiny drive: RMSE at most 1.5 times that of dead reckoning, plus 1 m."""
    truth = subject.recording.truth
    if truth is None:
        raise ValueError("the drive of the checks has no truth")
    steps = subject.steps(None)
    estimator = subject.new()
    poses = np.array([answer.pose for answer in drive(estimator, subject.setup(), steps)])
    finish = getattr(estimator, "finish", None)
    final = finish() if callable(finish) else None
    reference = [answer.pose for answer in drive(DeadReckoning(), subject.setup(), steps)]
    rmse, limit = (
        _rmse(poses if final is None else np.asarray(final), truth.poses),
        _rmse(np.array(reference), truth.poses),
    )
    limit = RMSE_FACTOR * limit + RMSE_SLACK_M
    require(
        rmse <= limit,
        f"position RMSE {rmse:.2f} m on a drive of 35 m, where dead reckoning allows {limit:.2f} m",
        "check frames, angles in the body frame, clock offsets in the distances (docs/reference/conventions.md)",
    )


Check = Callable[[Subject], None]
CHECKS: tuple[Check, ...] = (
    declares_what_it_is,
    answers_have_the_right_shapes,
    same_seed_same_answer,
    leaves_global_randomness_alone,
    leaves_its_input_alone,
    answers_stay_as_they_were,
    survives_empty_snapshots,
    does_not_mind_the_order,
    survives_missing_components,
    survives_other_intervals,
    pickles,
    covariances_are_positive,
    memory_does_not_grow,
    does_no_harm,
)


def _traced() -> int:
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def _rmse(poses: Floats, truth: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((poses[:, :2] - truth[:, :2]) ** 2, axis=1))))
