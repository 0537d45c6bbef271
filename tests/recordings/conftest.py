from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from subprocess import CompletedProcess, TimeoutExpired
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import loadmat

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.recordings.importing import matlab
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.recording import Recording

STEP_S = 0.02


@pytest.fixture
def mat_files_read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sound .mat files are read without a process of their own, which takes a second to begin."""

    def run(words: list[str], **_: object) -> CompletedProcess[bytes]:
        return CompletedProcess(words, 0, pickle.dumps(loadmat(words[-1], simplify_cells=False)))

    monkeypatch.setattr(matlab, "subprocess", SimpleNamespace(run=run, TimeoutExpired=TimeoutExpired))


@pytest.fixture(scope="session")
def take() -> Callable[..., Recording]:
    """Returns a recording with some rows of its measurements, and with some columns replaced."""

    def taken(recording: Recording, keep: np.ndarray | slice, **columns: np.ndarray) -> Recording:
        m = recording.measurements
        every = {field.name: getattr(m, field.name) for field in dataclasses.fields(m)} | columns
        kept = {name: None if column is None else column[keep] for name, column in every.items()}
        return dataclasses.replace(recording, measurements=dataclasses.replace(m, **kept))

    return taken


@pytest.fixture(scope="session")
def strip(take: Callable[..., Recording]) -> Callable[..., Recording]:
    """Returns a recording in which the named columns of the measurements were never measured."""

    def stripped(recording: Recording, *columns: str) -> Recording:
        nothing = np.full(len(recording.measurements), np.nan)
        return take(recording, slice(None), **dict.fromkeys(columns, nothing))

    return stripped


@pytest.fixture(scope="session")
def position_rmse() -> Callable[..., float]:
    """Position RMSE in m of an estimator by name and options on a recording."""

    def rmse(recording: Recording, name: str, **options: object) -> float:
        (request,) = resolve({name: options} if options else {}, [name], ())
        warm_up(request)
        return float(score(recording, estimate(recording, request, np.random.default_rng(5)), None)["position_rmse_m"])

    return rmse


@dataclass(frozen=True)
class Circuit:
    """A robot that drives figures of eight of some metres: times (N,), poses x, y, yaw (N, 3), speed, yaw rate (N,)."""

    time_s: np.ndarray
    poses: np.ndarray
    speed: np.ndarray
    turn: np.ndarray

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return poses (n, 3) at other times."""
        return np.column_stack([np.interp(time_s, self.time_s, column) for column in self.poses.T])


def circuit(duration_s: float, speed_mps: float, turn_radps: float) -> Circuit:
    """Return a drive of figures of eight, each loop 2 pi / turn_radps long."""
    t = STEP_S * np.arange(int(duration_s / STEP_S) + 1)
    turn = turn_radps * np.where(np.sin(0.5 * turn_radps * t) >= 0.0, 1.0, -1.0)
    yaw = 0.3 + np.concatenate([[0.0], np.cumsum(turn[:-1] * STEP_S)])
    middle = yaw + 0.5 * turn * STEP_S
    moves = speed_mps * STEP_S * np.column_stack([np.cos(middle), np.sin(middle)])
    place = np.array([2.0, -1.0]) + np.vstack([[0.0, 0.0], np.cumsum(moves[:-1], axis=0)])
    return Circuit(t, np.column_stack([place, yaw]), np.full(len(t), speed_mps), turn)


@pytest.fixture(scope="session")
def drive_eights() -> Callable[..., Circuit]:
    """The function `circuit`."""
    return circuit
