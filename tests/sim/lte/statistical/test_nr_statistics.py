"""The statistical front end of NR: its own constants, noise, samples and resolution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import poisson

from cellslam.scenarios.loading import load
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.persisting_errors import causes, floors
from cellslam.sim.lte.radio_config import NR_BANDS
from cellslam.sim.lte.statistical.statistical_front_end import model_of, noise_clutter_mean
from cellslam.sim.lte.statistical.statistics import statistics
from tests.sim.lte.statistical.test_detector import run
from tools.calibration.scenes import radio_of

BANDS = [f"nr-{blocks}" for blocks in NR_BANDS]
FALSE_ALARM = 1e-6
PATH = [[200.0, 0.0, 0.0]]


def config_of(band: str, **keys: float) -> RadioConfig:
    radio = radio_of("nr", int(band.removeprefix("nr-")))
    return radio.model_copy(update={"front_end": "statistical", **keys})


@pytest.mark.parametrize("band", BANDS)
def test_snr_and_errors_are_those_of_the_band(band: str) -> None:
    # -120 dB of path, 30 dBm, 2.16 dB of array loss, -123 dBm of noise per 15 kHz: 3.01 dB more in 30 kHz.
    d = run(config_of(band, clutter_scale=0.0), PATH, np.array([1e-6]), 1)
    np.testing.assert_allclose(d.measurements.snr_db, 30.0 - 120.0 - 2.16 + 123.0 - 10.0 * np.log10(2.0), atol=1e-9)
    config = config_of(band, clutter_scale=0.0, snr_cap_db=25.0, **{
        key: 0.0 for key in RadioConfig.model_fields if "_correlation_" in key})  # fmt: skip
    d = run(config, PATH, np.array([10.0**-7.5]), 4000)
    error = d.measurements.distance_m - 200.0
    own = statistics(band)
    np.testing.assert_allclose(floors(config), 10.0 ** (-6.0 / 20.0) * np.array(own.diffuse_floor), atol=0.01)
    assert np.std(error) == pytest.approx(d.true_std[0, 0], rel=0.1)


def test_diffuse_floors_of_other_bands_are_scaled() -> None:
    def floor(**keys: object) -> np.ndarray:
        return np.asarray(next(c.std for c in causes(RadioConfig(**keys)) if c.name == "diffuse"))  # type: ignore[arg-type]

    for blocks in NR_BANDS:  # from LTE's alone, beside what was measured
        scaled = floor(technology="nr", resource_blocks=blocks, prs_comb=6, prs_symbols=12, front_end="signal")
        np.testing.assert_allclose(scaled, floor(technology="nr", resource_blocks=blocks), rtol=0.07)
    # Errors in distance of a strong lone path from received signals, 300 a band.
    for blocks, measured_m in ((6, 4.71), (25, 2.63), (50, 1.54), (100, 0.64)):
        assert floor(resource_blocks=blocks)[0] == pytest.approx(measured_m, rel=0.25), blocks
    assert (floor(resource_blocks=100) == floor()).all()


@pytest.mark.parametrize("band", BANDS)
def test_clutter_is_counted_and_blurred_as_in_its_band(band: str) -> None:
    config, own = config_of(band), statistics(band)
    assert own.blur_m == pytest.approx(4.0 * 18e6 / config.waveform().bandwidth_hz)
    assert model_of(config, own).clutter.blur_m == own.blur_m
    count = 20_000
    d = run(config, PATH, np.array([1e-12]), count)  # a path that nobody sees: noise alone
    mean = noise_clutter_mean(config.detection_threshold, own) * count
    low, high = poisson.ppf([FALSE_ALARM, 1.0 - FALSE_ALARM], mean)
    assert low <= len(d.path) <= high


def test_threshold_is_that_of_the_band_unless_it_is_given() -> None:
    for blocks, threshold in ((48, 17.4), (132, 18.4), (272, 19.2)):
        assert load("lund-nr", {"radio.resource_blocks": blocks}).radio.detection_threshold == threshold
    assert load("lund-nr", {"radio.detection_threshold": 15.0}).radio.detection_threshold == 15.0
