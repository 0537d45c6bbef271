"""Packed recordings: how far values may be off, what is left out, and that they are mapped, not read."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.sim.recording.packing import mapped

Toy = Callable[..., Recording]


def claiming(recording: Recording, std: float) -> Recording:
    m = recording.measurements
    claims = std * (1.0 + np.random.default_rng(1).random((3, len(m))))
    more = dict(zip(("distance_std_m", "azimuth_std_rad", "elevation_std_rad"), claims, strict=True))
    return dataclasses.replace(recording, measurements=dataclasses.replace(m, **more))


@pytest.mark.parametrize(("std", "codes"), [(0.5, np.uint16), (1e-7, np.float64)])
def test_a_packed_recording_is_off_by_far_less_than_it_was_measured(
    toy_recording: Toy, tmp_path: Path, std: float, codes: type
) -> None:
    whole = claiming(toy_recording(snapshots=700), std)
    whole.save(tmp_path / "a.h5", pack=True)
    found, stored = Recording.load(tmp_path / "a.h5"), mapped(tmp_path / "a.h5")
    for name in ("distance_m", "azimuth_rad", "elevation_rad"):
        path = f"measurements/{name}"
        exact, rounded = (getattr(one.measurements, name) for one in (whole, found))
        assert np.abs(exact - rounded).max() <= 0.05 * std
        np.testing.assert_array_equal(stored[path][:], rounded)
        assert not stored[path].codes.flags.owndata, "read, not mapped"
    assert stored["measurements/distance_m"].codes.dtype == codes
    np.testing.assert_allclose(found.measurements.distance_std_m, whole.measurements.distance_std_m, rtol=0.016)
    np.testing.assert_array_equal(found.measurements.link, whole.measurements.link)
    np.testing.assert_array_equal(found.measurements.snapshot, whole.measurements.snapshot)
    np.testing.assert_array_equal(found.time_s, whole.time_s)
    assert found.truth is not None and whole.truth is not None
    np.testing.assert_allclose(found.truth.poses, whole.truth.poses, atol=1e-3)
    np.testing.assert_array_equal(found.truth.measurement_vt, whole.truth.measurement_vt)


def test_what_was_not_measured_stays_unknown_and_angles_stay_in_their_range(toy_recording: Toy, tmp_path: Path) -> None:
    whole = claiming(toy_recording(snapshots=700), 1e-4)
    azimuth, distance = whole.measurements.azimuth_rad.copy(), whole.measurements.distance_m.copy()
    azimuth[:3], distance[5:9] = [np.pi, -np.pi, np.nan], np.nan
    measurements = dataclasses.replace(whole.measurements, azimuth_rad=azimuth, distance_m=distance)
    dataclasses.replace(whole, measurements=measurements).save(tmp_path / "a.h5", pack=True)
    found = Recording.load(tmp_path / "a.h5").measurements
    np.testing.assert_array_equal(np.isnan(found.azimuth_rad), np.isnan(azimuth))
    np.testing.assert_array_equal(np.isnan(found.distance_m), np.isnan(distance))


def test_the_bound_of_a_packed_recording_is_refused_for_its_true_deviations(toy_recording: Toy, tmp_path: Path) -> None:
    whole = claiming(toy_recording(snapshots=60), 0.5)
    bound(whole)
    whole.save(tmp_path / "a.h5", pack=True)
    with pytest.raises(InputError, match="measurement_std is not known"):
        bound(Recording.load(tmp_path / "a.h5"))


def test_a_changed_byte_is_noticed_before_anything_is_mapped(toy_recording: Toy, tmp_path: Path) -> None:
    claiming(toy_recording(snapshots=700), 0.5).save(tmp_path / "a.h5", pack=True)
    content = bytearray((tmp_path / "a.h5").read_bytes())
    content[-1000] ^= 1
    (tmp_path / "a.h5").write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        mapped(tmp_path / "a.h5")
