"""What estimators are told of a receiver: of LTE of 20 MHz their defaults, of other bands what these give."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.scenarios.estimator_options import data_sheet, stated
from cellslam.scenarios.loading import from_tables, load
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.statistical.statistics import statistics
from cellslam.slam.measurements.measurement_options import MeasurementOptions


def test_the_sheet_of_lte_is_the_defaults() -> None:
    sheet, defaults = data_sheet(RadioConfig()), MeasurementOptions()
    assert len(sheet) == 6
    for key, value in sheet.items():
        assert value == pytest.approx(getattr(defaults, key), rel=0.006), key


def test_the_sheet_of_nr_is_of_its_band() -> None:
    radio = load("lund-nr").radio
    sheet, floor = data_sheet(radio), np.array(statistics("nr-272").diffuse_floor) * 10.0 ** (-6.0 / 20.0)
    # c / (2 pi B / sqrt 12), over the root of twice 128 ports x 3264 tones.
    noise_m = 299792458.0 / (2.0 * np.pi * 97.92e6 / 12**0.5) / (2.0 * 128.0 * 3264.0) ** 0.5
    assert sheet["noise_unit_snr_m"] == pytest.approx(noise_m, rel=0.005)
    assert sheet["noise_unit_snr_azimuth_deg"] == pytest.approx(0.0685 / (3264 / 200) ** 0.5, rel=0.005)
    told = np.array([sheet["diffuse_m"], *np.radians([sheet["diffuse_azimuth_deg"], sheet["diffuse_elevation_deg"]])])
    np.testing.assert_allclose(told, floor, rtol=0.005)


def test_scenarios_state_it_unless_they_say_otherwise() -> None:
    assert load("lund-530").estimator == {}
    tables = load("lund-nr", {"estimator.ekf-slam.diffuse_m": 0.5}).estimator
    sheet = data_sheet(load("lund-nr").radio)
    assert {"fastslam", "ekf-slam", "wall-slam", "bp-slam", "phd-slam", "oracle-map"} <= set(tables)
    assert tables["fastslam"] == sheet
    assert tables["ekf-slam"] == sheet | {"diffuse_m": 0.5}
    narrow = load("lund-nr", {"radio.resource_blocks": 48, "radio.front_end": "signal"}).estimator["fastslam"]
    assert narrow["noise_unit_snr_m"] > 5.0 * sheet["noise_unit_snr_m"]
    assert stated(RadioConfig(), {"fastslam": {}}) == {"fastslam": {}}


def test_what_is_resolved_states_it_again() -> None:
    scenario = load("lund-nr", {"radio.resource_blocks": 132, "radio.front_end": "signal"})
    assert from_tables(scenario.resolved).resolved == scenario.resolved
