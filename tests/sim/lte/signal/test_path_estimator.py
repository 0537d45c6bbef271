"""The path estimator: its normal equations, errors at the bound, detection, ghosts, collisions, motion, faults."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter
from threadpoolctl import threadpool_limits

from cellslam.sim.compiling import njit
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import CircularArray, PathSet, miscalibrated, switching_times_s
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.signal.path_estimator import fit_kernel, search_kernel
from cellslam.sim.lte.signal.path_estimator.cancellation import cancel
from cellslam.sim.lte.signal.path_estimator.path_estimator import Estimates, estimate_paths
from cellslam.sim.lte.signal.path_estimator.spectrum import Spectrum
from cellslam.sim.lte.signal.receiver import Receiver, receiver_of
from cellslam.sim.nr.nr_waveform import NrWaveform
from cellslam.sim.waveform.waveform import Waveform
from tools.front_end_reference import doppler_phasors, fisher_information, frequency_response, joint_std

evaluate, correlate, standing_out, local_level, level_around = (
    njit(getattr(part, "py_func", part), cache=True)  # a part is compiled already where Numba has no parts
    for part in (
        fit_kernel.evaluate, fit_kernel.correlate, search_kernel.standing_out, search_kernel.local_level,
        search_kernel.level_around,
    )
)  # fmt: skip
ARRAY, TONES = CircularArray(), LteWaveform(100).tones_hz
TIMES, CARRIER_HZ = switching_times_s(ARRAY), 2.66e9
RECEIVER, STILL = Receiver(), np.zeros(3)
AT_REST = RECEIVER.moving(STILL)
Complex = NDArray[np.complex128]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def draw(rng: np.random.Generator, rho_db: NDArray[np.float64], reach_m: float = 600.0) -> PathSet:
    """Paths of given SNR per sample at unit noise, anywhere within `reach_m`."""
    n = len(rho_db)
    distance, azimuth = rng.uniform(20.0, 20.0 + reach_m, n), rng.uniform(-np.pi, np.pi, n)
    elevation = rng.uniform(-0.05, 0.7, n)
    weights = rng.normal(size=(n, 2)) + 1j * rng.normal(size=(n, 2))
    signal = np.einsum("npq,nq->np", ARRAY.steer(azimuth, elevation).value, weights)
    level = 10.0 ** (rho_db / 20.0) / np.sqrt(np.mean(np.abs(signal) ** 2, axis=1))
    return PathSet(distance, azimuth, elevation, weights * level[:, None])


def noise(rng: np.random.Generator, tones: int = 200) -> Complex:
    return (rng.normal(size=(128, tones)) + 1j * rng.normal(size=(128, tones))) / np.sqrt(2.0)


def channel(paths: PathSet, velocity: NDArray[np.float64] = STILL, array: CircularArray = ARRAY) -> Complex:
    return frequency_response(array, TONES, TIMES, velocity, paths, CARRIER_HZ)


def errors(paths: PathSet, found: Estimates) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Error (n, 3) of each true path's nearest estimate, NaN where none is within 30 m and 60 degrees; its row."""
    truth = np.stack([paths.distance_m, paths.azimuth_rad, paths.elevation_rad], 1)
    if not len(found):
        return np.full(truth.shape, np.nan), np.zeros(len(truth), np.int64)
    apart = found.geometry[None] - truth[:, None]
    apart[..., 1] = wrap_angle(apart[..., 1])
    size = np.sum((apart / np.array([10.0, 0.3, 0.3])) ** 2, axis=-1)
    nearest = np.argmin(size, axis=1)
    error = apart[np.arange(len(truth)), nearest]
    error[(np.abs(error) > [30.0, 1.0, 1.0]).any(axis=1)] = np.nan
    return error, nearest


@pytest.mark.parametrize("count", [1, 3])
def test_normal_equations_are_those_of_the_full_jacobian(count: int) -> None:
    rng = np.random.default_rng(1)
    paths = draw(rng, np.array([0.0, -5.0, -3.0])[:count], 40.0)
    y = channel(paths) + noise(rng)
    geometry = np.stack([paths.distance_m + 1.0, paths.azimuth_rad + 0.05, paths.elevation_rad - 0.03], 1)
    got = evaluate(RECEIVER.at_distances(y), RECEIVER.grid, geometry, AT_REST.model)
    steering = ARRAY.steer(geometry[:, 1], geometry[:, 2])
    delay = np.exp(-1j * np.outer(geometry[:, 0], RECEIVER.rate))
    basis = np.einsum("npq,nf->pfnq", steering.value, delay).reshape(128 * 200, 2 * count)
    weights = np.linalg.lstsq(basis, y.ravel(), rcond=None)[0]
    np.testing.assert_allclose(got.weights.ravel(), weights, rtol=1e-6)
    residual = y.ravel() - basis @ weights
    np.testing.assert_allclose(got.explained, np.sum(np.abs(y) ** 2) - np.sum(np.abs(residual) ** 2), rtol=1e-6)
    joined = PathSet(geometry[:, 0], geometry[:, 1], geometry[:, 2], weights.reshape(count, 2))
    # The full information over seven parameters a path (tested against differences elsewhere), weights eliminated.
    full = fisher_information(ARRAY, TONES - TONES.mean(), joined, 2.0).reshape(count, 7, count, 7)
    kept, gone = (full[:, part, :, part].reshape(2 * [size * count]) for part, size in ((np.s_[:3], 3), (np.s_[3:], 4)))
    cross = full[:, :3, :, 3:].reshape(3 * count, 4 * count)
    np.testing.assert_allclose(got.information, kept - cross @ np.linalg.solve(gone, cross.T), rtol=1e-5, atol=1e-2)
    for p in range(count):
        others = np.delete(np.arange(2 * count), [2 * p, 2 * p + 1])
        fit = basis[:, others] @ np.linalg.lstsq(basis[:, others], y.ravel(), rcond=None)[0]
        lost = np.sum(np.abs(y.ravel() - fit) ** 2) - np.sum(np.abs(residual) ** 2)
        np.testing.assert_allclose(got.wald[p], lost, rtol=1e-5)


@pytest.mark.parametrize("waveform", [LteWaveform(100), LteWaveform(6), NrWaveform(40, 1, 4, 4)])
def test_correlations_between_searched_distances_are_those_of_the_tones(waveform: Waveform) -> None:
    receiver, rng = receiver_of(waveform), np.random.default_rng(2)
    y, found = noise(rng, len(receiver.rate)), np.empty((2, 128), complex)
    samples = np.asarray(y.astype(np.complex64) @ receiver.delay_matrix)
    for distance in (-50.0, -17.3, 0.0, 123.4, 1234.5, 1700.0):
        correlate(samples, distance, receiver.grid, found)
        tones = np.exp(1j * receiver.rate * distance)
        slope = np.std(receiver.rate)
        np.testing.assert_allclose(found[0], y @ tones, atol=1e-4 * np.sqrt(len(tones)))
        np.testing.assert_allclose(found[1], y @ (1j * receiver.rate * tones), atol=1e-4 * slope * np.sqrt(len(tones)))


def test_peaks_that_stand_out_are_all_of_them_the_strongest_first() -> None:
    rng = np.random.default_rng(3)
    y = channel(draw(rng, np.array([0.0, -10.0, -15.0]))) + noise(rng)
    spectrum = Spectrum(RECEIVER.at_distances(y), AT_REST)
    spectrum.evaluate()
    cells, _ = standing_out(spectrum.power, 10.0)
    energy = spectrum.power.energy
    # Azimuths wrap around, elevations and delays end.
    around_each = np.pad(energy.reshape(28, 7, -1), ((1, 1), (0, 0), (0, 0)), mode="wrap")
    highest = maximum_filter(around_each, 3, mode="nearest")[1:-1].reshape(energy.shape)
    expected = []
    for k, d in zip(*np.nonzero(energy >= 10.0 * spectrum.power.noise), strict=True):
        inside = fit_kernel.MARGIN <= d < energy.shape[1] - fit_kernel.MARGIN
        around = level_around(d, energy[k, d], spectrum.power)
        _, asked = local_level(k, d, energy[k, d], spectrum.power, energy[k, d] < spectrum.power.trailing[k // 7, d])
        if inside and energy[k, d] >= 10.0 * max(around, asked) and energy[k, d] == highest[k, d]:
            expected.append((-energy[k, d], k, d))
    assert len(expected) >= 3
    assert [tuple(cell) for cell in cells.tolist()] == [cell[1:] for cell in sorted(expected)]


def test_search_kernels_are_their_numpy_twins() -> None:
    rng = np.random.default_rng(4)
    motion = RECEIVER.moving(np.array([1.0, 0.0, 0.0])).weighed(rng.uniform(0.5, 1.5, 128))
    spectrum = Spectrum(RECEIVER.at_distances(noise(rng)), motion)
    spectrum.evaluate()
    steering = (
        ARRAY.steer(*RECEIVER.directions).value
        * doppler_phasors(TIMES, [1.0, 0.0, 0.0], *RECEIVER.directions, CARRIER_HZ)[:, :, None]
    )
    both, _ = np.linalg.qr(steering * motion.factor[:, None])  # two polarisations, each seen by all ports
    y = spectrum.samples
    energy = np.sum(np.abs(np.einsum("kpq,pd->kqd", both.conj(), y)) ** 2, axis=1)
    np.testing.assert_allclose(spectrum.power.energy, energy, rtol=1e-4, atol=1e-4)
    out = np.empty(spectrum.power.port_energy.shape)
    search_kernel.running_median(spectrum.power.port_energy, 31, out)
    np.testing.assert_allclose(out, median_filter(spectrum.power.port_energy, 31, mode="nearest"))


def test_taking_a_path_out_of_the_spectrum_is_transforming_the_residual() -> None:
    rng = np.random.default_rng(6)
    paths = draw(rng, np.array([10.0, -5.0]))
    y = channel(paths) + noise(rng)
    geometry = np.stack([paths.distance_m, paths.azimuth_rad, paths.elevation_rad], 1)
    spectrum = Spectrum(RECEIVER.at_distances(y), AT_REST)
    normal = evaluate(spectrum.samples, RECEIVER.grid, geometry, AT_REST.model)
    spectrum.leave(geometry, normal)
    on_tones = np.exp(-1j * np.outer(geometry[:, 0], RECEIVER.rate))
    on_ports = np.einsum("nmq,nq->mn", AT_REST.steer(geometry[:, 1], geometry[:, 2]).value, normal.weights)
    residual = Spectrum(RECEIVER.at_distances(y - on_ports @ on_tones), AT_REST)
    np.testing.assert_allclose(spectrum.residual, residual.samples, atol=3e-4)  # 2e-6 of the tones
    for one in (spectrum, residual):
        one.evaluate()
    np.testing.assert_allclose(spectrum.power.energy, residual.power.energy, rtol=1e-2, atol=1e-2)
    np.testing.assert_allclose(spectrum.power.noise, residual.power.noise, rtol=1e-2)


def test_a_strong_path_is_not_split() -> None:
    rng = np.random.default_rng(12)
    for _ in range(25):
        paths = draw(rng, np.array([20.0]), 1500.0)
        found = estimate_paths(channel(paths) + noise(rng), AT_REST)
        assert (np.abs(found.geometry[:, 0] - paths.distance_m[0]) < 12.0).sum() == 1


def test_calibration_error_makes_few_ghosts() -> None:
    rng = np.random.default_rng(8)
    ghosts = 0
    for _ in range(60):
        paths = draw(rng, np.array([20.0]))
        ghosts += (
            len(estimate_paths(channel(paths, array=miscalibrated(ARRAY, 5.0, 0.5, rng)) + noise(rng), AT_REST)) - 1
        )
    assert ghosts <= 15  # 0.11 a scene are usual


@pytest.mark.parametrize(("component", "step"), [(0, 4.0), (1, np.radians(6.0)), (2, np.radians(6.0))])
def test_two_close_paths_are_resolved_and_claim_no_more_than_they_know(component: int, step: float) -> None:
    rng, resolved, normalised = np.random.default_rng(9), 0, []
    for _ in range(20):
        one = draw(rng, np.zeros(1), 300.0)
        geometry = np.array([[one.distance_m[0], one.azimuth_rad[0], min(one.elevation_rad[0], 0.4)]] * 2)
        geometry[1, component] += step
        weights = np.repeat(one.weights, 2, axis=0) * np.exp(2j * np.pi * rng.random((2, 2)))
        paths = PathSet(*geometry.T, weights)
        found = estimate_paths(channel(paths) + noise(rng), AT_REST)
        error, row = errors(paths, found)
        if row[0] == row[1] or np.isnan(error).any() or (np.abs(error[:, component]) > 0.5 * step).any():
            continue
        resolved += 1
        normalised += [e @ np.linalg.solve(found.covariance[r], e) for e, r in zip(error, row, strict=True)]
    assert resolved >= 10
    assert np.mean(np.array(normalised) < 11.345) >= 0.9  # the 99 % band of three degrees of freedom


@pytest.mark.parametrize(("rho_db", "runs"), [(-28.0, 60), (10.0, 30)])
def test_single_path_is_at_the_bound_and_knows_its_error(rho_db: float, runs: int) -> None:
    rng = np.random.default_rng(5)
    to_bound, to_claim, found = [], [], 0
    for _ in range(runs):
        paths = draw(rng, np.array([rho_db]), 1500.0)
        result = estimate_paths(channel(paths) + noise(rng), AT_REST)
        error, row = errors(paths, result)
        if np.isfinite(error).all():
            found += 1
            to_bound.append(error[0] / joint_std(ARRAY, TONES, paths, 1.0)[0])
            to_claim.append(error[0] / np.sqrt(np.diag(result.covariance[row[0]])))
            assert abs(result.snr_db[row[0]] - rho_db) < 4.0
    assert found >= runs - 1
    tolerance = 4.0 / np.sqrt(2.0 * runs)
    for ratio in (to_bound, to_claim):
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(ratio), axis=0)), 1.0, atol=tolerance)


def test_half_is_found_near_minus_32_5_db() -> None:
    rng = np.random.default_rng(6)
    found = 0
    for _ in range(60):
        paths = draw(rng, np.array([-32.5]), 1500.0)
        found += int(np.isfinite(errors(paths, estimate_paths(channel(paths) + noise(rng), AT_REST))[0]).all())
    assert 12 <= found <= 48


def test_noise_alone_holds_hardly_any_path() -> None:
    rng = np.random.default_rng(10)
    assert sum(len(estimate_paths(noise(rng), AT_REST)) for _ in range(15)) <= 5


def test_ten_paths_are_found_and_tracked() -> None:
    rng = np.random.default_rng(7)
    found = tracked = false = 0
    for _ in range(12):
        paths = draw(rng, rng.uniform(-30.0, 0.0, 10))
        result = estimate_paths(channel(paths) + noise(rng), AT_REST)
        found += int(np.isfinite(errors(paths, result)[0]).all(axis=1).sum())
        false += max(len(result) - 10, 0)
        again = estimate_paths(channel(paths) + noise(rng), AT_REST, result.geometry)
        tracked += int(np.isfinite(errors(paths, again)[0]).all(axis=1).sum())
    assert found >= 115
    assert tracked >= 115
    assert false <= 6


@pytest.mark.parametrize("order", ["column", "ring"])
def test_motion_that_is_known_costs_nothing(order: str) -> None:
    times = switching_times_s(ARRAY, order)  # type: ignore[arg-type]
    receiver, velocity = Receiver(times_s=times), np.array([3.0, 0.0, 0.0])
    at_rest, moving = [], []
    for run in range(15):
        rng = np.random.default_rng(run)
        paths = draw(rng, np.array([-5.0]))
        still, moved = channel(paths), frequency_response(ARRAY, TONES, times, velocity, paths, CARRIER_HZ)
        added = noise(rng)
        # The noise is turned with the signal, so that both estimates meet the same.
        turn = doppler_phasors(times, velocity, paths.azimuth_rad, paths.elevation_rad, CARRIER_HZ)[0]
        at_rest.append(errors(paths, estimate_paths(still + added, AT_REST))[0][0])
        moving.append(errors(paths, estimate_paths(moved + added * turn[:, None], receiver.moving(velocity)))[0][0])
        ignored = errors(paths, estimate_paths(moved + added, AT_REST))[0][0]
        assert np.isnan(ignored).any() or np.abs(ignored[1:]).max() > 0.5 * np.abs(moving[-1][1:]).max()
    ratio = np.sqrt(np.mean(np.square(moving), axis=0) / np.mean(np.square(at_rest), axis=0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_a_colliding_cell_ten_thousand_times_as_strong() -> None:
    rng = np.random.default_rng(3)
    slots = 20 + np.arange(128)
    codes = {c: np.array([LteWaveform().values((c, 0), 3, int(s % 20)) for s in slots]) for c in (375, 177)}
    found = false = 0
    for _ in range(8):
        array = miscalibrated(ARRAY, 5.0, 0.5, rng)
        weak, strong = draw(rng, rng.uniform(-20.0, 0.0, 4)), draw(rng, np.array([20.0, 10.0, 5.0]))
        mixed = channel(weak, array=array) * codes[375] + channel(strong, array=array) * codes[177] + noise(rng)
        cleaned = cancel(mixed * codes[375].conj(), LteWaveform(), (375, 0), (177, 0), 3, slots)
        result = estimate_paths(cleaned, AT_REST)
        there = int(np.isfinite(errors(weak, result)[0]).all(axis=1).sum())
        found, false = found + there, false + len(result) - there
    assert found >= 31
    assert false <= 3


@pytest.mark.parametrize("fault", ["dead", "nan", "saturated"])
def test_a_faulty_port_does_not_break_the_estimate(fault: str) -> None:
    rng = np.random.default_rng(9)
    paths = draw(rng, np.array([5.0, -10.0]))
    y = channel(paths) + noise(rng)
    strange = {"dead": 0.0, "nan": np.nan, "saturated": 100.0 * noise(rng)[0]}[fault]
    y[17], y[90] = strange, strange
    error, _ = errors(paths, estimate_paths(y, AT_REST))
    assert (np.abs(error) < 6.0 * joint_std(ARRAY, TONES, paths, 1.0)).all()


@pytest.mark.parametrize(
    ("samples", "message"),
    [(np.full((128, 200), value, complex), "no array port delivered") for value in (0.0, np.nan, np.inf)]
    + [(np.ones(shape, complex), r"\(128, 200\) \(array ports, tones\) are exp") for shape in ((128, 100), (128,))],
)
def test_snapshots_without_samples_or_of_another_shape_are_refused(samples: Complex, message: str) -> None:
    with pytest.raises(InputError, match=message):
        estimate_paths(samples, AT_REST)


@pytest.mark.parametrize("blocks", [6, 7, 50])
def test_narrow_bands_are_estimated_too(blocks: int) -> None:
    rng, tones = np.random.default_rng(blocks), LteWaveform(blocks).tones_hz
    motion = receiver_of(LteWaveform(blocks)).moving(STILL)
    for _ in range(6):
        paths = draw(rng, np.array([0.0]), 800.0)
        clean = frequency_response(ARRAY, tones, TIMES, STILL, paths, CARRIER_HZ)
        found = estimate_paths(clean + noise(rng)[:, : len(tones)], motion)
        bound = joint_std(ARRAY, tones - tones.mean(), paths, 1.0)[0]
        strongest = found.geometry[np.argmax(found.statistic)]
        apart = strongest - [paths.distance_m[0], paths.azimuth_rad[0], paths.elevation_rad[0]]
        apart[1] = wrap_angle(apart[1])
        assert (np.abs(apart) < 5.0 * bound).all()


@pytest.mark.parametrize(("comb", "symbols"), [(4, 4), (4, 12)])
def test_nr_is_estimated_at_the_bound(comb: int, symbols: int) -> None:
    rng, waveform = np.random.default_rng(comb + symbols), NrWaveform(40, 1, comb, symbols)
    receiver, tones = receiver_of(waveform, 3.5e9), waveform.tones_hz
    assert receiver.fitted.size > 1
    apart, level_db = [], []
    for _ in range(10):
        paths = draw(rng, np.array([0.0]), 800.0)
        signal = frequency_response(receiver.array, tones, TIMES, STILL, paths, 3.5e9)
        pair = rng.standard_normal((2, 128, len(tones)))
        found = estimate_paths(signal + (pair[0] + 1j * pair[1]) / np.sqrt(2.0), receiver.moving(STILL))
        error, row = errors(paths, found)
        apart.append(error[0] / joint_std(receiver.array, tones, paths, 1.0)[0])
        level_db.append(found.snr_db[row[0]])
    ratio = np.sqrt(np.mean(np.square(apart), axis=0))
    assert (ratio > 0.5).all() and (ratio < 1.6).all()
    assert abs(np.median(level_db)) < 0.2
