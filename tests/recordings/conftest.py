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

from cellslam.sim.recording import Recording

DURATION_S = float(os.environ.get("CELLSLAM_VEHICLE_S", "240"))


@pytest.fixture(scope="session")
def vehicle_world() -> ModuleType:
    """The maker of synthetic drives in the layout of the vehicle data set."""
    path = Path(__file__).with_name("vehicle_world.py")
    spec = importlib.util.spec_from_file_location("vehicle_world", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["vehicle_world"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def vehicle_drive(vehicle_world: ModuleType) -> object:
    """Minutes among 500 trees; CELLSLAM_VEHICLE_S=3600 makes it an hour."""
    return vehicle_world.drive(DURATION_S, 500, 1)


@pytest.fixture(scope="session")
def vehicle_files(vehicle_world: ModuleType, vehicle_drive: object, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the three .mat files."""
    folder = tmp_path_factory.mktemp("victoria")
    vehicle_world.write(folder, vehicle_drive, 2)
    return folder


def stripped(recording: Recording, *columns: str) -> Recording:
    """Return a recording in which the named columns of the measurements were never measured."""
    nothing = np.full(len(recording.measurements), np.nan)
    measurements = dataclasses.replace(recording.measurements, **dict.fromkeys(columns, nothing))
    return dataclasses.replace(recording, measurements=measurements)


@pytest.fixture(scope="session")
def strip() -> Callable[..., Recording]:
    """The function `stripped`."""
    return stripped
