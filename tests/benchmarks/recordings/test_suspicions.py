"""Each usual mistake is planted in sound data, and is named; sound data raise nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from importlib.resources import files

import numpy as np
import pytest

from cellslam.benchmarks.recordings.adapters.victoria_park import load as load_victoria_park
from cellslam.benchmarks.recordings.inspection.suspicions import suspicions
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle
from cellslam.sim.recording import Recording, Reference

Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def cellular() -> Recording:
    """A simulated drive of 30 s through a city, of which a reference at 2 Hz is known, with yaw."""
    r = Recording.load(str(files("cellslam.slam.conformance").joinpath("conformance_drive.h5")))
    assert r.truth is not None
    poses, every = r.truth.poses[::7], slice(None, None, 7)
    reference = Reference(r.time_s[every], poses[:, :3], poses[:, 3], np.full(len(poses), 0.1))
    return dataclasses.replace(r, truth=None, reference=reference)


@pytest.fixture(scope="module")
def trees(vehicle_files: object) -> Recording:
    """A vehicle among trees, with GPS without yaw."""
    return load_victoria_park(vehicle_files)  # type: ignore[arg-type]


def measured(**changes: Callable[[np.ndarray], np.ndarray]) -> Change:
    def change(r: Recording) -> Recording:
        m = r.measurements
        new = {name: function(getattr(m, name)) for name, function in changes.items()}
        return dataclasses.replace(r, measurements=dataclasses.replace(m, **new))

    return change


def driven(component: int, factor: float) -> Change:
    def change(r: Recording) -> Recording:
        odometry = r.odometry.copy()
        odometry[:, component] *= factor
        return dataclasses.replace(r, odometry=odometry)

    return change


def swapped_reference(r: Recording) -> Recording:
    assert r.reference is not None
    position = r.reference.position_m[:, [1, 0, 2]]
    return dataclasses.replace(r, reference=dataclasses.replace(r.reference, position_m=position))


def compass_yaw(r: Recording) -> Recording:
    assert r.reference is not None
    yaw = wrap_angle(np.pi / 2 - r.reference.yaw_rad)
    return dataclasses.replace(r, reference=dataclasses.replace(r.reference, yaw_rad=yaw))


SAMPLE_M = SPEED_OF_LIGHT_MPS / 30.72e6
MISTAKES: dict[str, tuple[Change, tuple[str, ...], tuple[str, ...]]] = {
    "delays in ns": (measured(distance_m=lambda d: d / (1e-9 * SPEED_OF_LIGHT_MPS)), ("nanoseconds",), ("ns",)),
    "delays in samples": (
        measured(distance_m=lambda d: np.round(d / SAMPLE_M) + np.arange(len(d)) % 1),
        ("samples",),
        ("sample_rate_hz",),
    ),
    "clockwise azimuth": (measured(azimuth_rad=lambda a: -a), ("clockwise",), ("clockwise", "sign = -1")),
    "clockwise yaw": (driven(3, -1.0), ("clockwise",), ("clockwise", "u_psi")),
    "azimuth from the left": (
        measured(azimuth_rad=lambda a: wrap_angle(a - np.pi / 2)),
        ("azimuth-zero",),
        ("swapped axes",),
    ),
    "axes of the azimuth swapped": (
        measured(azimuth_rad=lambda a: wrap_angle(np.pi / 2 - a)),
        ("azimuth-zero", "clockwise"),
        ("swapped axes",),
    ),
    "odometry backwards": (driven(0, -1.0), ("odometry-sign",), ("wrong sign",)),
    "yaw rate in deg/s": (driven(3, 180.0 / np.pi), ("degrees-as-radians",), ("degrees", "deg/s")),
    "yaw rate divided twice": (driven(3, np.pi / 180.0), ("radians-as-degrees",), ("rad/s",)),
    "azimuth divided twice": (
        measured(azimuth_rad=lambda a: a * np.pi / 180.0),
        ("radians-as-degrees",),
        ('unit = "rad"',),
    ),
    "km/h for m/s": (driven(0, 3.6), ("speed-unit",), ("km/h",)),
    "reference with x and y swapped": (swapped_reference, ("swapped-axes",), ("swapped", "exchange x_m and y_m")),
}


def test_sound_data_raise_nothing(cellular: Recording, trees: Recording) -> None:
    assert suspicions(cellular) == [] and suspicions(trees) == []


LACKS = (
    ("elevation_rad", "snr_db"),
    ("azimuth_rad", "elevation_rad"),
    ("distance_m",),
    ("distance_m", "elevation_rad"),
)


@pytest.mark.parametrize("columns", LACKS)
def test_sound_data_that_lack_something_raise_nothing(
    columns: tuple[str, ...], cellular: Recording, strip: Callable[..., Recording]
) -> None:
    recording = strip(cellular, *columns)
    assert suspicions(recording) == []
    odometry = recording.odometry.copy()
    odometry[:, [1, 2, 4, 5]] = np.nan
    assert suspicions(dataclasses.replace(recording, odometry=odometry, reference=None)) == []


@pytest.mark.parametrize("world", ["cellular", "trees"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(mistake: str, world: str, request: pytest.FixtureRequest) -> None:
    change, kinds, words = MISTAKES[mistake]
    if mistake == "delays in samples" and world == "trees":
        change = measured(distance_m=lambda d: np.round(d * 3.0) + np.zeros(len(d)))
        base = without_repeats(request.getfixturevalue(world), lambda d: np.round(d * 3.0))
    elif mistake == "delays in samples":
        base = without_repeats(request.getfixturevalue(world), lambda d: np.round(d / SAMPLE_M))
    else:
        base = request.getfixturevalue(world)
    found = {s.kind: s.text for s in suspicions(change(base))}
    for kind in kinds:
        assert kind in found, (found, kinds)
    for word in words:
        assert any(word in text for text in found.values()), (word, found)


def without_repeats(r: Recording, rounding: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """Drop rows that rounding would make equal."""
    m = r.measurements
    key = np.column_stack([m.snapshot, m.link, rounding(m.distance_m), np.round(m.azimuth_rad, 12)])
    keep = np.sort(np.unique(key, axis=0, return_index=True)[1])
    columns = {f.name: getattr(m, f.name) for f in dataclasses.fields(m)}
    kept = {name: None if c is None else c[keep] for name, c in columns.items()}
    return dataclasses.replace(r, measurements=dataclasses.replace(m, **kept))


def test_a_clockwise_yaw_of_the_reference_is_named(cellular: Recording) -> None:
    found = {s.kind: s.text for s in suspicions(compass_yaw(cellular))}
    assert "clockwise" in found and "yaw" in found["clockwise"]


def test_degrees_do_not_pass_for_radians(cellular: Recording) -> None:
    from cellslam.sim.errors import InputError

    with pytest.raises(InputError, match=r"azimuth_rad, row \d+: .*degrees"):
        measured(azimuth_rad=np.degrees)(cellular)
