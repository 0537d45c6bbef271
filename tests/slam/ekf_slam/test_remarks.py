"""An EKF-SLAM that was told wrong sizes of errors says so, and one that was told right ones does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording

CAUSES = ("diffuse_m", "diffuse_azimuth_deg", "diffuse_elevation_deg", "roof_azimuth_deg", "roof_elevation_deg")


@pytest.fixture(scope="module")
def drive() -> Recording:
    return simulate(load("tiny", {"radio.clock_offset_std_m": 0.0}), 3, 0)


@pytest.mark.parametrize("name", ["ekf-slam", "fastslam"])
@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_errors_that_are_not_as_large_as_told_are_remarked(drive: Recording, name: str, factor: float) -> None:
    options: dict[str, Any] = dict(Origin.of(drive).options.get(name, {}))
    (right,) = resolve({name: options}, (name,))
    wrong = {cause: factor * getattr(right.options, cause) for cause in CAUSES}
    (request,) = resolve({name: options | wrong | ({"particles": 32} if name == "fastslam" else {})}, (name,))
    remarks = estimate(drive, request, np.random.default_rng(0)).remarks
    if factor == 1.0:
        assert remarks == ()
    else:
        (said,) = remarks
        # Angles better than told are no mistake: what is counted for merged paths makes them look so. Azimuths worse
        # than told are taken for merged paths, in part.
        assert ("roof" in said) == (factor < 1.0) and ("roof of elevation" in said) == (factor < 1.0)
        assert "diffuse of distance" in said


def test_right_sizes_are_not_remarked_on_when_a_drive_tells_them_well() -> None:
    drive = simulate(load("lund-530", {"vehicle.duration_s": 150.0, "vehicle.distance_m": 150.0}), 4, 0)
    (right,) = resolve({"ekf-slam": dict(Origin.of(drive).options.get("ekf-slam", {}))}, ("ekf-slam",))
    assert estimate(drive, right, np.random.default_rng(0)).remarks == ()
