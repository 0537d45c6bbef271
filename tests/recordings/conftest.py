from __future__ import annotations

import dataclasses
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.recording import Recording
from tests.command_line import cellslam

__all__ = ["cellslam"]
DURATION_S = float(os.environ.get("CELLSLAM_VEHICLE_S", "240"))


def loaded(name: str) -> ModuleType:
    """Return a module beside this file, which studies import, too, by its plain name."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def vehicle_world() -> ModuleType:
    """The maker of synthetic drives in the layout of the vehicle data set."""
    return loaded("vehicle_world")


@pytest.fixture(scope="session")
def worlds() -> ModuleType:
    """The makers of campaigns of several kinds, and mistakes to plant in them."""
    return loaded("mistaken_worlds")


@pytest.fixture(scope="session")
def vehicle_drive(vehicle_world: ModuleType) -> object:
    """Minutes among 500 trees; CELLSLAM_VEHICLE_S=3600 makes it an hour."""
    return vehicle_world.drive(DURATION_S, 500, 1)


@pytest.fixture(scope="session")
def strip() -> Callable[..., Recording]:
    """Returns a recording in which the named columns of the measurements were never measured."""

    def stripped(recording: Recording, *columns: str) -> Recording:
        nothing = np.full(len(recording.measurements), np.nan)
        measurements = dataclasses.replace(recording.measurements, **dict.fromkeys(columns, nothing))
        return dataclasses.replace(recording, measurements=measurements)

    return stripped


@pytest.fixture(scope="session")
def take() -> Callable[..., Recording]:
    """Returns a recording with some rows of its measurements, and with some columns replaced."""

    def taken(recording: Recording, keep: np.ndarray, **columns: np.ndarray) -> Recording:
        m = recording.measurements
        every = {field.name: getattr(m, field.name) for field in dataclasses.fields(m)} | columns
        kept = {name: None if column is None else column[keep] for name, column in every.items()}
        return dataclasses.replace(recording, measurements=dataclasses.replace(m, **kept))

    return taken


@pytest.fixture(scope="session")
def position_rmse() -> Callable[..., float]:
    """Position RMSE in m of an estimator by name and options on a recording."""

    def rmse(recording: Recording, name: str, **options: object) -> float:
        (request,) = resolve({name: options} if options else {}, [name], ())
        warm_up(request)
        return float(score(recording, estimate(recording, request, np.random.default_rng(5)), None)["position_rmse_m"])

    return rmse
