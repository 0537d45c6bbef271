"""Each usual mistake is planted in sound campaigns, and is named; sound ones raise nothing.

`python studies/study_mistakes.py` does so for every kind of campaign and every mistake.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from cellslam.recordings import Campaign, OdometryTable, build
from cellslam.recordings.inspection.suspicions import suspicions
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle
from cellslam.sim.recording import Recording
from tests.recordings import mistaken_worlds as worlds

SAMPLE_M = SPEED_OF_LIGHT_MPS / 30.72e6
# Each mistake once, where it is hard to see.
HARD = (
    ("azimuth in radians taken for degrees", "hall"),
    ("nanoseconds for metres", "places"),
    ("clockwise azimuth", "hall"),
    ("yaw rate of the wrong sign", "places"),
    ("yaw rate in degrees", "trees"),
    ("speed backwards", "beacons"),
    ("reference with x and y swapped", "cellular"),
    ("reference in feet", "hall"),
    ("reference 5 s late", "hall"),
    ("odometry 2 s late", "places"),
    ("measurements 1 s late", "cellular"),
    ("20 m on every distance", "hall"),
    ("lever arm left out", "trees"),
    ("nanoseconds for metres", "few places"),
    ("clockwise azimuth", "few places"),
    ("20 m on every distance", "tubes"),
    ("yaw rate in degrees", "rover"),
)


@cache
def right(world: str) -> Campaign:
    """A sound campaign; mistakes are planted in copies."""
    return worlds.WORLDS[world](101)


@pytest.fixture(scope="module")
def cellular() -> Recording:
    """A simulated drive of 30 s through a city, of which a reference at 2 Hz is known, with yaw."""
    return build(worlds.cellular(0))


@pytest.mark.slow
@pytest.mark.parametrize("world", ["hall", "few places", "beacons", "rover", "tubes", "trees", "cellular"])
def test_sound_campaigns_raise_nothing(world: str) -> None:
    assert suspicions(build(right(world))) == []


@pytest.mark.slow
@pytest.mark.parametrize(("mistake", "world"), HARD)
def test_a_mistake_is_named(mistake: str, world: str) -> None:
    plant, kinds = worlds.MISTAKES[mistake]
    found = [s.kind for s in suspicions(build(plant(right(world))))]
    assert found and found[0] in kinds, found


def test_headings_that_jitter_are_no_degrees() -> None:
    """Odometry at 100 Hz from poses that jitter by a degree turns by 100 degrees a second, and nowhere."""
    t = 0.01 * np.arange(3000)
    jitter = np.radians(1.0) * np.random.default_rng(0).standard_normal(len(t))
    wheels = OdometryTable(t[1:], {"u_x": np.ones(len(t) - 1), "u_psi": np.diff(jitter) / 0.01}, "before")
    ranges = Campaign(t[1:], {"distance_m": np.hypot(20.0 - t[1:], 5.0)}, wheels, start_pose=(0.0,) * 6)
    assert suspicions(build(ranges)) == []


def test_an_arm_of_the_reference_points_to_the_array() -> None:
    """A reference 2 m behind the array is cured by the lever arm that `recording.toml` asks for."""
    hall = right("hall")
    assert hall.reference is not None
    behind = worlds.at_arm(np.column_stack([hall.reference.position_m, hall.reference.yaw_rad]), (-2.0, 0.0))
    moved = dataclasses.replace(hall.reference, position_m=behind[:, :2], yaw_rad=None)
    found = suspicions(build(dataclasses.replace(hall, reference=moved)))
    arm = re.search(r"reference.lever_arm_m = \[(\S+), ", " ".join(s.text for s in found))
    assert arm is not None and float(arm[1]) == pytest.approx(2.0, abs=0.3)


@pytest.mark.slow
def test_the_remedy_is_told() -> None:
    """The mistake is measured, and its cure is in the words of `recording.toml`."""
    plant, _ = worlds.MISTAKES["odometry 2 s late"]
    found = suspicions(build(plant(right("hall"))))
    late = re.search(r"offset_s = -(\S+) and clock = \"NAME\" in \[odometry\]", found[0].text)
    assert late is not None and float(late[1]) == pytest.approx(2.0, abs=0.2)
    assert "measured paths and odometry" in found[0].text and "reference and odometry" in found[0].text


@pytest.mark.parametrize("columns", [("azimuth_rad", "elevation_rad"), ("distance_m", "elevation_rad")])
def test_sound_data_that_lack_something_raise_nothing(
    columns: tuple[str, ...], cellular: Recording, strip: Callable[..., Recording]
) -> None:
    recording = strip(cellular, *columns)
    odometry = recording.odometry.copy()
    odometry[:, [1, 2, 4, 5]] = np.nan
    assert suspicions(dataclasses.replace(recording, odometry=odometry)) == []


def test_whole_numbers_are_samples(cellular: Recording, take: Callable[..., Recording]) -> None:
    m = cellular.measurements
    samples = np.round(m.distance_m / SAMPLE_M)
    key = np.column_stack([m.snapshot, m.link, samples, np.round(m.azimuth_rad, 12)])
    once = np.sort(np.unique(key, axis=0, return_index=True)[1])  # rounding makes some rows equal
    found = suspicions(take(cellular, once, distance_m=samples))
    assert [s.kind for s in found] == ["samples"] and "sample_rate_hz" in found[0].text


@pytest.mark.slow
def test_a_clockwise_yaw_of_the_reference_is_named(cellular: Recording) -> None:
    assert cellular.reference is not None
    yaw = wrap_angle(np.pi / 2 - cellular.reference.yaw_rad)
    mistaken = dataclasses.replace(cellular, reference=dataclasses.replace(cellular.reference, yaw_rad=yaw))
    found = {s.kind: s.text for s in suspicions(mistaken)}
    assert "clockwise" in found and "yaw" in found["clockwise"]
