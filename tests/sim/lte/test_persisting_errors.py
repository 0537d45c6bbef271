"""Errors that persist: their size, over what they change, what shares them, and that white ones stay white."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cellslam.sim.frames import azimuth_elevation, unit_vector, world_to_body
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.persisting_errors import causes, draw_fields, floors, persisting_std, white_floors
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Streams
from cellslam.sim.lte.statistical.measurement_kernel import write_attitude, write_persisting
from cellslam.sim.lte.statistical.statistical_front_end import detect
from tests.sim.lte.statistical.test_detector import make_cells

Floats = NDArray[np.float64]
VT = np.array([120.0, 90.0, 40.0])
SWITCHES = {
    "calibration": ("calibration_distance_m", "calibration_azimuth_deg", "calibration_elevation_deg"),
    "roof": ("roof_azimuth_deg", "roof_elevation_deg"),
    "attitude": ("attitude_azimuth_deg", "attitude_elevation_deg"),
}


def only(cause: str, **keys: float) -> RadioConfig:
    """A configuration with one cause of error."""
    off = {key: 0.0 for name, group in SWITCHES.items() if name != cause for key in group}
    if cause != "diffuse":
        off["specular_to_diffuse_db"] = 40.0
        off["diffuse_correlation_m"] = 0.0
    return RadioConfig(**(off | keys))


def error(fields, geo, place, port=0, snapshot=0, vt=VT) -> Floats:  # type: ignore[no-untyped-def]
    """Persisting error (3,) of a path with geometry `geo` at `place`."""
    attitude, out = np.empty(3), np.empty(3)
    write_attitude(snapshot, fields, attitude)
    write_persisting(np.array(geo), np.concatenate([place, np.zeros(3)]), vt, port, attitude, fields, out)
    return out


def correlation(config: RadioConfig, one: tuple, other: tuple, trials: int = 400) -> Floats:  # type: ignore[type-arg]
    """Correlation (3,) over trials of the errors at two sets of arguments of `error`."""
    pairs = []
    for trial in range(trials):
        fields = draw_fields(config, 0.075, np.random.default_rng(trial))
        pairs.append([error(fields, *one), error(fields, *other)])
    a, b = np.array(pairs).transpose(1, 0, 2)
    with np.errstate(invalid="ignore"):
        return np.mean(a * b, axis=0) / np.sqrt(np.mean(a**2, axis=0) * np.mean(b**2, axis=0))


@pytest.mark.parametrize("cause", ["calibration", "roof", "diffuse", "attitude"])
def test_each_cause_has_its_size_and_can_be_switched(cause: str) -> None:
    config = only(cause)
    drawn = [error(draw_fields(config, 0.075, np.random.default_rng(t)), (150.0, 0.7, 0.0), VT) for t in range(1500)]
    expected = next(c for c in causes(config) if c.name == cause).std
    np.testing.assert_allclose(np.std(drawn, axis=0), expected, rtol=0.1, atol=1e-12)
    np.testing.assert_allclose(persisting_std(config), expected, rtol=1e-9)
    scale = next(k for k in RadioConfig.model_fields if k.startswith(f"{cause}_correlation"))
    white = only(cause, **{scale: 0.0})
    assert (error(draw_fields(white, 0.075, np.random.default_rng(1)), (150.0, 0.7, 0.2), VT) == 0.0).all()
    np.testing.assert_allclose(white_floors(white), floors(white))


def test_an_error_is_the_sum_of_its_waves() -> None:
    fields, rng = draw_fields(RadioConfig(), 0.075, np.random.default_rng(3)), np.random.default_rng(4)
    for _ in range(5):
        (azimuth, elevation), place, port = rng.uniform(-1.0, 1.0, 2), rng.uniform(-900.0, 900.0, 3), rng.integers(4)
        unit = unit_vector(azimuth, elevation)
        expected = np.zeros(3)
        for f, component in enumerate([0, 1, 2, 1, 2]):
            waves = np.cos(fields.direction_wave[f] @ unit + fields.direction_phase[f])
            expected[component] += fields.direction_std[f] * np.sqrt(2.0 / len(waves)) * waves.sum()
        for f in range(3):
            phase = fields.place_phase[f] + fields.port_phase[f, :, port]
            waves = np.cos(fields.place_wave[f] @ np.concatenate([place, VT]) + phase)
            expected[f] += fields.place_std[f] * np.sqrt(2.0 / len(waves)) * waves.sum()
        still = fields._replace(time_std=np.zeros(3))
        found = error(still, (150.0, azimuth, elevation), place, port)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


HERE, PLACE = (150.0, 0.7, 0.2), np.array([3.0, 4.0, 1.8])


@pytest.mark.parametrize(
    ("cause", "one", "other", "expected"),
    [
        # Alike for all sites, ports and times in one direction; a turn by the scale, and by many.
        ("calibration", (HERE, VT), ((300.0, 0.7, 0.2), VT + 70.0, 1, 999, -VT), 1.0),
        ("calibration", ((150.0, 0.7, 0.0), VT), ((150.0, 0.7 + np.radians(15.0), 0.0), VT), np.exp(-0.5)),
        ("calibration", (HERE, VT), ((150.0, 2.7, 0.2), VT), 0.0),
        # Frozen at a stop; on the way by the scale, and by many; another port; another VT.
        ("diffuse", (HERE, PLACE, 0, 0), (HERE, PLACE, 0, 500), 1.0),
        ("diffuse", (HERE, PLACE), (HERE, PLACE + np.array([0.2, 0.0, 0.0])), np.exp(-0.5)),
        ("diffuse", (HERE, PLACE), (HERE, PLACE + 1.0), 0.0),
        ("diffuse", (HERE, PLACE), (HERE, PLACE, 1), 0.0),
        ("diffuse", (HERE, PLACE), (HERE, PLACE, 0, 0, VT + 1.0), 0.0),
    ],
)
def test_errors_persist_over_what_they_belong_to(cause: str, one: Any, other: Any, expected: float) -> None:
    config = only(cause, **({"diffuse_correlation_m": 0.2} if cause == "diffuse" else {}))
    atol = {1.0: 1e-7, 0.0: 0.2}.get(expected, 0.12)
    np.testing.assert_allclose(correlation(config, one, other), expected, atol=atol)


def test_attitude_turns_all_paths_of_a_snapshot_together() -> None:
    config = only("attitude")
    fields = draw_fields(config, 0.075, np.random.default_rng(3))
    turn = np.empty(3)
    write_attitude(7, fields, turn)
    for azimuth, elevation in ((0.3, 0.2), (-2.0, 0.5), (1.6, -0.1)):
        direction = unit_vector(azimuth, elevation)
        seen = azimuth_elevation(world_to_body(np.concatenate([np.zeros(3), turn]), direction))
        got = error(fields, (100.0, azimuth, elevation), VT, snapshot=7)
        np.testing.assert_allclose(got[1:], [seen[0] - azimuth, seen[1] - elevation], atol=3e-4)
    later = correlation(config, ((100.0, 0.3, 0.2), VT, 0, 0), ((100.0, 0.3, 0.2), VT, 0, 2))
    np.testing.assert_allclose(later[1:], np.exp(-0.5), atol=0.12)


def test_sectors_of_a_site_share_the_error_and_the_claim_covers_it() -> None:
    count = 3000
    rng = np.random.default_rng(1)
    poses = np.zeros((count, 6))
    poses[:, :2] = rng.uniform(-30.0, 30.0, (count, 2))
    poses[:, 3] = rng.uniform(-3.0, 3.0, count)
    gain = np.tile(1e-5 * np.eye(2), (count, 1, 1)).astype(np.complex128)
    paths = PathColumns(np.arange(count + 1), np.tile(VT, (count, 1)), gain, np.zeros((count, 2)))
    config = RadioConfig(load=0.0, evm=0.0, clutter_scale=0.0)
    fields = draw_fields(config, 0.075, rng)
    d = detect(config, make_cells(40.0, 40.0), paths, poses, np.zeros(1), fields, Streams.spawn(rng))
    m = d.measurements
    distance = np.linalg.norm(VT - poses[:, :3], axis=1)
    for link in (0, 1):
        off = m.distance_m[m.link == link] - distance
        assert abs(np.std(off) / d.true_std[0, 0] - 1.0) < 0.15
    np.testing.assert_allclose(m.distance_m[m.link == 0], m.distance_m[m.link == 1], atol=0.05)
