"""The statistical detector: link budget by hand, its statistics with fixed seeds, exactness without noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, ncx2, poisson

from cellslam.sim.errors import InputError
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.links import Cells, cells_of
from cellslam.sim.lte.persisting_errors import draw_fields, floors
from cellslam.sim.lte.statistical.clutter_kernel import BLUR_AZIMUTH_RAD, STRETCH
from cellslam.sim.lte.statistical.detector_layout import GAMMA_START_DB, GAMMA_STEP_DB, PathColumns, Streams
from cellslam.sim.lte.statistical.statistical_front_end import Detections, detect, noise_clutter_mean
from cellslam.sim.lte.statistical.statistics import BLUR_M, statistics

FALSE_ALARM = 1e-6
WHITE = {k: 0.0 for k in RadioConfig.model_fields if "_correlation_" in k}
Floats = NDArray[np.float64]
FIELDS = draw_fields(RadioConfig(noise_scale=0.0), 0.075, np.random.default_rng(0))


def make_cells(*azimuths_deg: float, ports: int = 1, tilt_deg: float = 0.0) -> Cells:
    cells = [SimpleNamespace(cell_id=i, azimuth_deg=a, tilt_deg=tilt_deg) for i, a in enumerate(azimuths_deg)]
    return cells_of([SimpleNamespace(cells=cells, ports=ports)])


def make_paths(vts: Floats, amplitude: Floats, count: int, departure: float = 0.0) -> PathColumns:
    """The same paths (n) in each of `count` snapshots of one site; sent and received in equal
    polarisation.
    """
    n = len(vts)
    gain = np.asarray(amplitude)[:, None, None] * np.eye(2)
    return PathColumns(
        rows=n * np.arange(count + 1),
        vt_m=np.tile(vts, (count, 1)),
        gain=np.tile(gain, (count, 1, 1)).astype(np.complex128),
        departure_rad=np.tile([departure, 0.0], (n * count, 1)),
    )


def run(
    config: RadioConfig, vts: Floats, amplitude: Floats, count: int, seed: int = 1, cells: Cells | None = None
) -> Detections:
    paths = make_paths(np.asarray(vts, np.float64), amplitude, count)
    streams = Streams.spawn(np.random.default_rng(seed))
    fields = draw_fields(config, 0.075, np.random.default_rng(seed))
    return detect(config, cells or make_cells(0.0), paths, np.zeros((count, 6)), np.zeros(1), fields, streams)


def quiet(**keys: float | bool) -> RadioConfig:
    """A configuration without interference and clutter, all errors white."""
    return RadioConfig(**({"load": 0.0, "evm": 0.0, "clutter_scale": 0.0} | WHITE | keys))


def amplitude_for(gamma: float, config: RadioConfig) -> float:
    """Path amplitude that gives the integrated SNR `gamma` on the horizon at boresight."""
    rho_db = 10.0 * np.log10(gamma / 25_600.0)
    return float(10.0 ** ((rho_db + config.noise_dbm - config.eirp_dbm + 2.16) / 20.0))


@pytest.mark.parametrize(
    ("keys", "vts", "amplitude", "azimuths_deg", "snr_db"),
    [
        # -120 dB of path, 30 dBm, 2.16 dB of array loss, -123 dBm of noise: 30.84 dB, under a cap of 60.
        ({"snr_cap_db": 60.0}, [[100.0, 0.0, 0.0]], 1e-6, [0.0], [30.0 - 120.0 - 2.16 + 123.0]),
        ({}, [[100.0, 0.0, 0.0]], 1e-3, [0.0], [25.0]),  # capped
        # The second cell is 70 degrees off: 12 dB down. With load 0.3 and no other noise: 12 + 5.23 dB.
        ({"load": 0.3, "noise_dbm": -140.0, "snr_cap_db": 60.0}, [[100.0, 0.0, 0.0]], 1e-4, [0.0, 70.0],
         [12.0 + 5.229, -12.0 + 5.229]),
        # 5 % EVM is -26 dB of the link's total power; two equal paths halve what each can reach.
        ({"evm": 0.05, "noise_dbm": -140.0, "snr_cap_db": 60.0}, [[100.0, 0.0, 0.0], [0.0, 400.0, 0.0]], 1e-4, [0.0],
         [26.021 - 3.010] * 2),
    ],
    ids=["link budget", "cap", "interference", "error of the transmitter"],
)  # fmt: skip
def test_snr_by_hand(
    keys: dict[str, float], vts: list[list[float]], amplitude: float, azimuths_deg: list[float], snr_db: list[float]
) -> None:
    d = run(quiet(**keys), np.array(vts), np.full(len(vts), amplitude), 1, cells=make_cells(*azimuths_deg))
    np.testing.assert_allclose(d.measurements.snr_db, snr_db, atol=0.01)


def test_a_cell_is_received_by_the_angle_off_its_boresight() -> None:
    # A path departs at 1 rad: along the first cell's boresight, 57.3 degrees off the second's, 97.3 off the third's.
    paths, cells = make_paths(np.array([[100.0, 0.0, 0.0]]), np.array([1e-6]), 1, 1.0), make_cells(57.2958, 0.0, -40.0)
    streams = Streams.spawn(np.random.default_rng(1))
    d = detect(quiet(snr_cap_db=60.0), cells, paths, np.zeros((1, 6)), np.zeros(1), FIELDS, streams)
    loss_db = np.array([0.0, 12.0 * (57.2958 / 70.0) ** 2, 12.0 * (97.2958 / 70.0) ** 2])
    np.testing.assert_allclose(d.measurements.snr_db, 30.0 - 120.0 - 2.16 + 123.0 - loss_db, atol=0.01)


def test_ports_are_slanted() -> None:
    # A path that passes only what is sent at +45 degrees: the second port gets nothing through it.
    paths = make_paths(np.array([[100.0, 0.0, 0.0]]), np.array([1.0]), 1)
    plus = np.array([1.0, 1.0]) / np.sqrt(2.0)
    paths = PathColumns(paths.rows, paths.vt_m, 1e-6 * np.outer(plus, plus)[None].astype(complex), paths.departure_rad)
    streams = Streams.spawn(np.random.default_rng(1))
    d = detect(quiet(), make_cells(0.0, ports=2), paths, np.zeros((1, 6)), np.zeros(1), FIELDS, streams)
    assert d.measurements.link.tolist() == [0]


@pytest.mark.parametrize(("gamma_db", "scale"), [(11.6, 1.0), (15.0, 1.0), (13.0, 0.6)])
def test_isolated_path_is_detected_as_the_law_says(gamma_db: float, scale: float) -> None:
    config, count = quiet(detection_scale=scale), 20_000
    gamma = 10.0 ** (gamma_db / 10.0)
    d = run(config, [[100.0, 0.0, 0.0]], np.array([amplitude_for(gamma, config)]), count)
    chance = scale * ncx2.sf(2.0 * config.detection_threshold, statistics().dof, statistics().gain * gamma)
    assert abs(len(d.path) / count - chance) < 5.0 * np.sqrt(chance * (1.0 - chance) / count)


@pytest.mark.parametrize("amplitude", [1e-5, 3e-9])
def test_errors_have_the_claimed_size_and_no_mean(amplitude: float) -> None:
    count = 20_000
    vt = np.array([[300.0, 150.0, 60.0]])
    d = run(quiet(detection_scale=1.0, detection_threshold=8.0), vt, np.array([amplitude]), count)
    m = d.measurements
    n = len(m)
    exact = np.array([np.linalg.norm(vt), np.arctan2(150.0, 300.0), np.arctan2(60.0, np.hypot(300.0, 150.0))])
    error = np.stack([m.distance_m, m.azimuth_rad, m.elevation_rad], 1) - exact
    claimed = np.stack([m.distance_std_m, m.azimuth_std_rad, m.elevation_std_rad], 1)
    np.testing.assert_array_equal(claimed, d.true_std)
    z2 = ((error / claimed) ** 2).sum(axis=0)
    low, high = chi2.ppf([FALSE_ALARM / 2, 1.0 - FALSE_ALARM / 2], n)
    assert n > 1000
    assert ((z2 > low) & (z2 < high)).all()
    assert (np.abs(error.mean(axis=0)) < 5.0 * claimed.mean(axis=0) / np.sqrt(n)).all()


def test_claims_are_bound_plus_floors() -> None:
    config = quiet()
    d = run(config, [[100.0, 0.0, 0.0]], np.array([amplitude_for(25_600.0, config)]), 1)
    bound = np.array([0.04053, np.radians(0.0685), np.radians(0.0704)])
    np.testing.assert_allclose(d.true_std[0], np.hypot(bound, floors(config)), rtol=1e-3)


def test_noise_clutter_is_poisson_and_uniform() -> None:
    config, count = RadioConfig(clutter_scale=3.0), 20_000
    d = run(config, np.empty((0, 3)), np.empty(0), count)
    mean = 3.0 * noise_clutter_mean(config.detection_threshold, statistics()) * count
    low, high = poisson.ppf([FALSE_ALARM, 1.0 - FALSE_ALARM], mean)
    assert low < len(d.path) < high
    m = d.measurements
    assert abs(np.mean(m.distance_m) - 825.0) < 5.0 * 1750.0 / np.sqrt(12.0 * len(m))
    assert abs(np.mean(m.azimuth_rad)) < 5.0 * 2.0 * np.pi / np.sqrt(12.0 * len(m))


@pytest.mark.parametrize(("ratio_db", "node"), [(6.0, 4), (40.0, 10)])
def test_clutter_around_a_lone_path_is_as_calibrated(ratio_db: float, node: int) -> None:
    config = RadioConfig(load=0.0, evm=0.0, detection_threshold=40.0, specular_to_diffuse_db=ratio_db)
    count, table = 20_000, statistics().clutter_at(ratio_db)
    gamma_db = GAMMA_START_DB + GAMMA_STEP_DB * node
    d = run(config, [[200.0, 0.0, 0.0]], np.array([amplitude_for(10.0 ** (gamma_db / 10.0), config)]), count)
    m, clutter = d.measurements, d.path < 0
    low, high = poisson.ppf([FALSE_ALARM, 1.0 - FALSE_ALARM], table.mean[node] * count)
    assert low <= clutter.sum() <= high
    assert clutter.sum() > 1000
    drawn = np.column_stack([m.distance_m[clutter] - 200.0, m.azimuth_rad[clutter], m.snr_db[clutter]])
    points = table.points[node][:, [0, 1, 3]]
    blur = np.array([BLUR_M, BLUR_AZIMUTH_RAD, 0.0])
    stretch = STRETCH**2 / 3.0 * np.array([1.0, 1.0, 0.0])
    expected = np.sqrt(points.var(axis=0) + stretch * np.mean(points**2, axis=0) + blur**2)
    assert (np.abs(drawn.mean(axis=0) - points.mean(axis=0)) < 5.0 * expected / np.sqrt(len(drawn))).all()
    np.testing.assert_allclose(drawn.std(axis=0), expected, rtol=0.05)
    # Delay and direction belong together.
    together = [np.corrcoef(np.abs(p[:, 0]), np.abs(p[:, 1]))[0, 1] for p in (drawn, points)]
    assert abs(together[0] - together[1]) < 0.1


def test_clutter_is_hidden_behind_what_is_stronger() -> None:
    config, count = RadioConfig(load=0.0, evm=0.0, detection_threshold=40.0), 5000
    weak, strong = (amplitude_for(10.0 ** (x / 10.0), config) for x in (25.0, 50.0))
    alone = run(config, [[200.0, 0.0, 0.0]], np.array([weak]), count)
    stronger = run(config, [[170.0, 0.0, 0.0]], np.array([strong]), count)
    both = run(config, [[200.0, 0.0, 0.0], [170.0, 0.0, 0.0]], np.array([weak, strong]), count)
    more = (both.path < 0).sum() - (stronger.path < 0).sum()
    assert (alone.path < 0).sum() > 500
    assert more < 0.3 * (alone.path < 0).sum()


def test_paths_in_company_have_as_much_more_clutter_as_was_measured() -> None:
    config, count = RadioConfig(load=0.0, evm=0.0, detection_threshold=40.0), 4000
    strong = amplitude_for(1e4, config)
    apart = [[200.0, 0.0, 0.0], [-700.0, 0.0, 0.0]]
    lone = [(run(config, [vt], np.array([strong]), count).path < 0).sum() for vt in apart]
    both = (run(config, apart, np.array([strong, strong]), count).path < 0).sum()
    assert both / sum(lone) == pytest.approx(statistics().company_at(config.specular_to_diffuse_db), rel=0.1)


def test_merged_paths_pull_the_stronger_one() -> None:
    config, count = quiet(noise_scale=1.0), 4000
    weak, strong = amplitude_for(10.0, config), amplitude_for(100.0, config)
    d = run(config, [[100.0, 0.0, 0.0], [102.0, 0.0, 0.0]], np.array([strong, weak]), count)
    assert (d.path % 2 == 1).sum() < 0.01 * count
    alone = d.path % 2 == 0
    s2 = (2.0 / 9.1710) ** 2
    merged = np.exp(-s2) * (1.0 + s2)
    shift = merged * 10.0 / 110.0 * 2.0
    std = d.true_std[alone, 0].mean() / np.sqrt(alone.sum())
    assert abs(d.measurements.distance_m[alone].mean() - 100.0 - shift) < 5.0 * std
    assert shift > 4.0 * std
    np.testing.assert_allclose(np.median(d.merging_shift[alone], axis=0), [shift, 0.0, 0.0], rtol=1e-3, atol=1e-12)


def test_angles_stay_in_range_near_the_pole() -> None:
    config = quiet(roof_elevation_deg=20.0)
    d = run(config, [[1.0, 0.5, 300.0]], np.array([1e-5]), 2000)
    m = d.measurements
    assert len(m) > 1000
    assert np.abs(m.elevation_rad).max() <= np.pi / 2
    assert np.abs(m.azimuth_rad).max() <= np.pi
    # Measurements pushed over the pole come down on the other side.
    assert 0.3 < np.mean(np.abs(m.azimuth_rad - np.arctan2(0.5, 1.0)) > np.pi / 2) < 0.7


@pytest.mark.parametrize("persisting", [False, True])
def test_blocks_and_single_snapshots_draw_the_same(persisting: bool) -> None:
    count, config = 1300, RadioConfig(clutter_scale=3.0, persisting_clutter=persisting)
    paths = make_paths(np.array([[100.0, 0.0, 0.0], [0.0, 150.0, 9.0]]), np.array([1e-6, 1e-8]), count)
    cells, poses = make_cells(0.0, 120.0, ports=2), np.zeros((count, 6))
    whole = detect(config, cells, paths, poses, np.zeros(1), FIELDS, Streams.spawn(np.random.default_rng(2)))
    streams = Streams.spawn(np.random.default_rng(2))
    pieces = []
    for t in range(count):
        one, _ = paths.of_snapshots(t, t + 1, 1)
        pieces.append(detect(config, cells, one, poses[t : t + 1], np.zeros(1), FIELDS, streams, first_snapshot=t))
    assert len(whole.path) > count
    for name in ("snapshot", "link", "distance_m", "azimuth_rad", "elevation_rad", "snr_db", "distance_std_m"):
        joined = np.concatenate([getattr(p.measurements, name) for p in pieces])
        np.testing.assert_array_equal(joined, getattr(whole.measurements, name))


def test_errors_do_not_depend_on_what_is_detected() -> None:
    vts, amplitude = [[100.0, 0.0, 0.0], [0.0, 150.0, 9.0]], np.array([1e-6, 1e-6])
    every = run(quiet(), vts, amplitude, 50)
    some = run(quiet(detection_scale=0.5), vts, amplitude, 50)
    assert 0 < len(some.path) < len(every.path)
    rows = np.isin(every.path, some.path)
    np.testing.assert_array_equal(every.measurements.distance_m[rows], some.measurements.distance_m)


def test_rows_within_a_link_are_ordered_by_distance() -> None:
    d = run(RadioConfig(clutter_scale=5.0), [[300.0, 0.0, 0.0], [0.0, 150.0, 9.0]], np.array([1e-6, 1e-6]), 200)
    m = d.measurements
    same = (np.diff(m.snapshot) == 0) & (np.diff(m.link) == 0)
    assert same.sum() >= 200
    assert (np.diff(m.distance_m)[same] >= 0.0).all()


def test_a_cell_id_given_twice_is_refused() -> None:
    cell = SimpleNamespace(cell_id=7, azimuth_deg=0.0, tilt_deg=0.0)
    with pytest.raises(InputError, match="cell ID 7 is given twice"):
        cells_of([SimpleNamespace(cells=[cell], ports=1), SimpleNamespace(cells=[cell], ports=1)])


def test_clutter_is_interpolated_between_the_ratios_measured() -> None:
    known = dict(statistics().clutter)
    low, high = sorted(known)[:2]
    between = statistics().clutter_at(0.25 * low + 0.75 * high)
    np.testing.assert_allclose(between.mean, 0.25 * known[low].mean + 0.75 * known[high].mean)
    count = between.points.shape[1]
    from_high = (between.points == known[high].points).all(axis=(0, 2)).sum()
    assert abs(from_high / count - 0.75) <= 1.0 / count
    np.testing.assert_array_equal(statistics().clutter_at(high).points, known[high].points)
    assert all((c.mean >= 0.0).all() and np.isfinite(c.points).all() for c in known.values())
