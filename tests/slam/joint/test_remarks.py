"""An EKF-SLAM that assumes wrong sizes of errors says so, and one that assumes right ones does not."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.joint.ekf_slam import EkfSlam
from tests.slam.driving import driven

CAUSES = {
    "diffuse": ("diffuse_m", "diffuse_azimuth_deg", "diffuse_elevation_deg"),
    "roof": ("roof_azimuth_deg", "roof_elevation_deg"),
}


@pytest.fixture(scope="module")
def drive() -> Recording:
    return simulate(load("tiny", {"radio.clock_offset_std_m": 0.0}), 3, 0)


def assuming(drive: Recording, cause: str, factor: float) -> Request:
    """What is asked for where one cause of errors is told so many times too large."""
    name, options = "ekf-slam", dict(Origin.of(drive).options.get("ekf-slam", {}))
    (right,) = resolve({name: options}, (name,))
    wrong = {size: factor * getattr(right.options, size) for size in CAUSES[cause]}
    (request,) = resolve({name: options | wrong}, (name,))
    return request


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "factor", "words"),
    [
        ("diffuse", 0.5, ("diffuse of distance", "diffuse of azimuth", "diffuse of elevation")),
        ("roof", 0.5, ("roof of elevation",)),  # azimuths worse than assumed are taken for merged paths, in part
        # Angles better than assumed are no mistake: what is counted for merged paths makes them look so.
        ("diffuse", 2.0, ("diffuse of distance",)),
        ("roof", 2.0, ()),
    ],
)
def test_errors_that_are_not_as_large_as_told_are_remarked(
    drive: Recording, cause: str, factor: float, words: tuple[str, ...]
) -> None:
    remarks = estimate(drive, assuming(drive, cause, factor), np.random.default_rng(0)).remarks
    assert tuple(re.findall(r"\w+ of \w+", "".join(remarks))) == words


def after(drive: Recording, request: Request, grows: bool = True) -> EkfSlam:
    """Return the filter that was asked for after a drive."""
    estimator = EkfSlam(request.options)
    estimator.grows = grows
    driven(estimator, drive)
    return estimator


@pytest.mark.slow
def test_diffuse_errors_are_taken_for_as_large_as_they_are(drive: Recording) -> None:
    half = assuming(drive, "diffuse", 0.5)
    grown = after(drive, half).sizes()
    assert 1.5 < grown.grown < 2.7
    # What the drive says besides is said against these.
    assert abs(grown.slopes()["diffuse_m"][0]) < 4.0 * np.sqrt(grown.slopes()["diffuse_m"][1])
    kept = after(drive, half, grows=False).sizes()
    assert kept.grown == 1.0 and 1.5 < kept.doubted()["diffuse_m"] < 2.7
    for factor in (1.0, 2.0):
        assert after(drive, assuming(drive, "diffuse", factor)).sizes().grown == 1.0


@pytest.mark.slow
def test_right_sizes_are_not_remarked_on_when_a_drive_tells_them_well() -> None:
    drive = simulate(load("lund-530", {"vehicle.duration_s": 150.0, "vehicle.distance_m": 150.0}), 4, 0)
    (right,) = resolve({"ekf-slam": dict(Origin.of(drive).options.get("ekf-slam", {}))}, ("ekf-slam",))
    assert estimate(drive, right, np.random.default_rng(0)).remarks == ()
