"""Estimators that do what none should, each in its own way, at snapshot 5 if not said otherwise; `Good` does not."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import signal
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.trials.answers import encoded
from cellslam.sim.frames import integrate_pose
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate, WallEstimate

NOW = 5
MISFITS = Path(__file__).read_text("utf-8")  # this module, to be written under the name `misfits`


class Good:
    """Integrates the odometry."""

    name = "good"

    def __init__(self, options: Any) -> None:
        del options

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        self.setup, self.pose, self.rng = setup, setup.start_pose, rng

    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Any:
        self.pose = integrate_pose(self.pose, odometry, dt_s)
        answer = Estimate(self.pose + 0.01 * self.rng.normal(size=6), np.eye(6))
        return self.odd(answer, snapshot) if snapshot.index == NOW else answer

    def odd(self, answer: Estimate, snapshot: Snapshot) -> Any:
        del snapshot
        return answer


class Slow(Good):
    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Any:
        time.sleep(0.004)
        return super().step(dt_s, odometry, snapshot)


class NoTextError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


class OwnError(BaseException):
    pass


def raising(error: Any) -> Any:
    def odd(*_: Any) -> Any:
        raise error() if callable(error) else error

    return odd


def noted() -> Exception:
    error = ValueError("with notes")
    error.__notes__ = [NoTextError(), "\ud800"]  # type: ignore[list-item]
    return error


def answering(**values: Any) -> Any:
    def odd(self: Any, answer: Estimate, snapshot: Snapshot) -> Any:
        return dataclasses.replace(answer, **{k: v(snapshot) if callable(v) else v for k, v in values.items()})

    return odd


def doing(act: Any) -> Any:
    def odd(self: Any, answer: Estimate, snapshot: Snapshot) -> Any:
        act(self)
        return answer

    return odd


def hang(_: Any) -> None:
    while True:
        time.sleep(0.1)


def write_everywhere(message: bytes) -> None:
    for fd in range(3, 64):
        with contextlib.suppress(OSError):
            os.write(fd, message)


def answer_often(_: Any) -> None:
    about = {"snapshot": NOW, "seconds": 1e-6, "remarks": [], "peak_memory_mb": 0.0}
    message = encoded(about, {"pose": np.zeros(6), "covariance": np.eye(6)})
    write_everywhere(101 * (len(message).to_bytes(8, "little") + message))


def leave_orphan_and_hang(_: Any) -> None:
    """What it leaves is of another session, and its parent is gone."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            Path("orphan").write_text(str(os.getpid()))
            hang(None)
        os._exit(0)
    hang(None)


def eat_memory_in_children(_: Any) -> None:
    for _ in range(4):
        if os.fork() == 0:
            hang(np.ones(2**25))  # 256 MiB
    hang(None)


def print_much(_: Any) -> None:
    for _ in range(100):
        os.write(2, 100_000 * b"-")
    os.write(2, b"last words")
    os._exit(6)


def leave_child_and_die(_: Any) -> None:
    if os.fork():
        os._exit(3)
    time.sleep(20)  # holds the pipe open


ASYMMETRIC = np.eye(6)
ASYMMETRIC[0, 1] = 0.5
INDEFINITE = np.eye(6)
INDEFINITE[0, 1] = INDEFINITE[1, 0] = 2.0
EVIL = b"cos\nsystem\n(S'touch pickled'\ntR."
NO_ANSWER = "no answer within the time limit of"
SMALL = (np.zeros(1, int), np.zeros((1, 3)), np.zeros((1, 3, 3)))

# What each does, and the words that its row then says.
ODD: dict[str, tuple[Any, str]] = {
    "Surrogate": (raising(ValueError("lone \ud800 surrogate")), "ValueError: lone \ufffd surrogate, snapshot 5"),
    "NoWords": (raising(NoTextError), "NoTextError: (no text: its __str__ raised RuntimeError), snapshot 5"),
    "Notes": (raising(noted), "ValueError: with notes, (no text: its __str__ raised RuntimeError), \ufffd, snapshot 5"),
    "Long": (raising(lambda: ValueError("x" * 50_000_000)), "(shortened from 50000000 characters), snapshot 5"),
    "Interrupts": (raising(KeyboardInterrupt), "KeyboardInterrupt, snapshot 5"),
    "SystemExits": (raising(SystemExit), "SystemExit, snapshot 5"),
    "OwnBase": (raising(OwnError), "OwnError, snapshot 5"),
    "Stops": (raising(StopIteration), "generator raised StopIteration"),
    "Recursion": (doing(lambda self: self.odd(None, None)), "RecursionError"),
    "Exits": (doing(lambda _: os._exit(7)), "its process ended with exit status 7"),
    "Segfaults": (doing(lambda _: ctypes.string_at(0)), "its process was killed by SIGSEGV"),
    "LeavesChild": (doing(leave_child_and_die), "its process ended with exit status 3"),
    "Hangs": (doing(hang), NO_ANSWER),
    "HangsInC": (doing(lambda _: ctypes.PyDLL(None).sleep(1000)), NO_ANSWER),  # holds the interpreter: no thread runs
    "EatsMemory": (doing(lambda _: [np.empty(10**8) for _ in range(100)]), "MemoryError"),
    "ClosesAll": (doing(lambda _: os.closerange(3, 256)), "its process ended with exit status"),
    "AnswersOften": (doing(answer_often), "its process sent an answer out of turn, where that of snapshot 6"),
    "LeavesOrphan": (doing(leave_orphan_and_hang), NO_ANSWER),
    "EatsInChildren": (doing(eat_memory_in_children), "of memory, the limit is 0.75 GiB"),
    "Prints": (doing(print_much), "its process ended with exit status 6"),
    "Garbage": (doing(lambda _: write_everywhere(b"\xffgarbage" * 100)), "its process sent what is no answer"),
    "Pickle": (doing(lambda _: write_everywhere(len(EVIL).to_bytes(8, "little") + EVIL)), "its process sent"),
    "NotFinite": (answering(pose=np.full(6, np.nan)), "pose is not finite, snapshot 5"),
    "Complex": (answering(pose=np.zeros(6, complex)), "pose holds complex128, expected real numbers, snapshot 5"),
    "Ragged": (answering(pose=[1, [2, 3]]), "ValueError: setting an array element with a sequence"),
    "NoEstimate": (lambda *_: {"pose": 1}, "step returned dict, expected cellslam.slam.api.Estimate, snapshot 5"),
    "Far": (answering(pose=np.full(6, 1e200)), "pose holds 1e+200, the most is 1e+09, snapshot 5"),
    "Negative": (answering(covariance=-np.eye(6)), "covariance has a negative variance, snapshot 5"),
    "Asymmetric": (answering(covariance=ASYMMETRIC), "covariance is not symmetric, snapshot 5"),
    "Indefinite": (answering(covariance=INDEFINITE), "covariance has a negative eigenvalue, snapshot 5"),
    "ShortPose": (answering(pose=np.zeros(3)), "pose has shape (3,), expected (6,), snapshot 5"),
    "ManyIds": (answering(association=np.zeros(99, int)), "association has shape (99,)"),
    "ThreeClocks": (answering(clock_offset_m=np.zeros(3)), "clock_offset_m has shape (3,), expected (2,)"),
    "FarLink": (answering(vts=VtEstimate(np.arange(1), np.array([9]), *SMALL[1:])), "4 links"),
    "BigIds": (
        answering(association=lambda snapshot: np.full(len(snapshot), 1e300)),
        "association holds more than whole numbers up to 2^53, snapshot 5",
    ),
    "NegativeIds": (
        answering(association=lambda snapshot: np.full(len(snapshot), -7)),
        "association holds -7, expected a VT's id, or -1 for none, snapshot 5",
    ),
    "TwoDimensionalIds": (
        answering(vts=VtEstimate(np.zeros((1, 1), int), *SMALL)),
        "vts.id has shape (1, 1), expected (1,), snapshot 5",
    ),
    "NegativeVts": (
        answering(vts=VtEstimate(np.zeros(1, int), *SMALL[:2], -np.eye(3)[None])),
        "vts.covariance has a negative variance, VT 0",
    ),
    "WallThatEndsFirst": (
        answering(walls=WallEstimate(np.arange(1), np.zeros(1), np.zeros(1), np.eye(2)[None], np.array([[4.0, 3.0]]))),
        "walls.extent_m has an end before its begin, snapshot 5",
    ),
    "NegativeOffset": (
        answering(clock_offset_variance_m2=lambda _: np.full(2, -1.0)),
        "clock_offset_variance_m2 holds -1: a variance is not negative",
    ),
    "Constructor": (raising(OwnError("not made")), "OwnError: not made"),
    "HangsAtStart": (lambda *_: hang(None), NO_ANSWER),
    "WarmUpExits": (lambda _: os._exit(5), "its process ended with exit status 5"),
    "FinishOfAnotherShape": (lambda _: np.zeros((3, 6)), "finish(): poses has shape (3, 6)"),
    "RemarksANumber": (lambda _: 7, "remarks() returned int, expected a list of lines of text"),
}
# The methods that are odd in place of an answer.
METHODS = {"Constructor": "__init__", "HangsAtStart": "start", "WarmUpExits": "warm_up"}
METHODS |= {"FinishOfAnotherShape": "finish", "RemarksANumber": "remarks"}
for _name, (_odd, _) in ODD.items():
    globals()[_name] = type(_name, (Good,), {METHODS.get(_name, "odd"): _odd, "__module__": __name__})


# Those that follow answer rightly, and must have the row of `Good`: what they do stays with them.


class Patches(Good):
    """Would make every score 0, for all."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        for module in [module for name, module in sys.modules.items() if name.startswith("cellslam.benchmarks")]:
            for name in ("score", "errors_over_time", "explained", "bound", "record"):
                if callable(getattr(module, name, None)):  # not the package `bound`
                    setattr(module, name, lambda *_, **__: {"position_rmse_m": 0.0})
        from cellslam.benchmarks.scores import metrics

        metrics.score = lambda *_: {"position_rmse_m": 0.0}  # type: ignore[assignment,dict-item]


class Disturbs(Good):
    """Changes what a process has of its own, and leaves it changed."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        print("printed on stdout")
        os.write(1, b"written on stdout\n")
        os.chdir("/")
        np.seterr(all="raise")
        np.random.seed(0)  # noqa: NPY002
        os.environ.clear()
        warnings.simplefilter("error")
        sys.setrecursionlimit(200)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        sys.stdout = sys.stderr = None  # type: ignore[assignment]
        sys.path.clear()
        threading.Thread(target=time.sleep, args=(3600,)).start()

    def remarks(self) -> list[str]:
        return ["two\nlines"]


class Mutates(Good):
    """Writes into what it is given, and into what it has answered."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        self.pose, self.buffer, self.before = setup.start_pose.copy(), np.zeros(6), np.eye(6)
        object.__setattr__(setup, "start_pose", np.full(6, 1e6))
        setup.start_std.setflags(write=True)
        setup.start_std[:] = 1e6

    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Any:
        answer = super().step(dt_s, odometry, snapshot)
        self.buffer[:] = answer.pose
        snapshot.distance_m.setflags(write=True)
        snapshot.distance_m[:] = np.nan
        self.before[:] = np.nan
        self.before = np.eye(6)
        return dataclasses.replace(answer, pose=self.buffer, covariance=self.before)


class Foresees(Good):
    """Says that it needs the future, and looks whether all of it is there."""

    requires_future = True

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        assert setup.future is not None
        self.left = list(setup.future)

    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Any:
        dt, velocity, seen = self.left.pop(0)
        assert (dt, seen.index) == (dt_s, snapshot.index)
        assert np.array_equal(velocity, odometry)
        return super().step(dt_s, odometry, snapshot)

    def remarks(self) -> list[str]:
        return [f"{len(self.left)} left"]


class Peeks(Good):
    """Looks for the truth and the future in all that its process holds."""

    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Any:
        import gc

        from cellslam.sim.recording import Recording

        held = gc.get_objects() if snapshot.index == NOW else []
        if any(isinstance(one, Recording) for one in held):
            raise RuntimeError("the truth is here")
        if any(isinstance(one, Snapshot) and one.index > NOW for one in held):
            raise RuntimeError("the future is here")
        return super().step(dt_s, odometry, snapshot)


HARMLESS = ("Patches", "Disturbs", "Mutates", "Peeks", "Foresees")
