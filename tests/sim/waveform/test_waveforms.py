"""What a front end relies on in a waveform: LTE, NR, and the example of one's own."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.nr.nr_waveform import NrWaveform
from cellslam.sim.nr.prs import positioning_reference_signal
from cellslam.sim.waveform import Waveform
from cellslam.sim.waveform.waveform import checked

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples" / "own-waveform"
PORTS = [(cell, port) for cell in (375, 376, 177) for port in (0, 1)]


def own() -> Waveform:
    return RadioConfig(technology="pilot_tones:PilotTones", front_end="signal").waveform()


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    sys.modules.pop("pilot_tones", None)


@pytest.mark.parametrize(
    "made", [LteWaveform, lambda: LteWaveform(6), NrWaveform, lambda: NrWaveform(24, 2, 6, 12), own]
)
def test_a_waveform_keeps_the_protocol(made: type[Waveform]) -> None:
    w = checked(made(), 1000.0)
    assert hash(w) == hash(made()) and w == made()
    assert w.bandwidth_hz < 1.2 * np.ptp(w.tones_hz) and 0.0 < w.sample_s <= 1.0 / w.bandwidth_hz
    combs = w.combs(PORTS)
    assert len(combs) == len(PORTS)
    first, second = w.values(PORTS[0], combs[0], 0), w.values(PORTS[2], combs[2], 0)
    assert abs(np.vdot(first, second)) < 5.0 * np.sqrt(len(first))


@pytest.mark.parametrize(("comb", "symbols"), [(2, 2), (4, 12), (6, 12), (12, 12)])
def test_nr_values_stand_on_their_tones(comb: int, symbols: int) -> None:
    w = NrWaveform(28, 1, comb, symbols)
    signal = positioning_reference_signal(4 * 375 + 1, 7, 1, 28, comb, symbols, element_offset=1)
    subcarrier = np.rint(w.tones_hz / w.element_hz + 0.5 * (12 * 28 - 1)).astype(int)
    values = w.values((375, 1), 1, 7)
    for k in (0, 1, 17, 335):
        mine = signal.values[signal.subcarriers == k]
        np.testing.assert_array_equal(values[subcarrier == k], mine)
        assert len(mine) == symbols // comb
    assert w.tones_hz.mean() == pytest.approx(0.0, abs=1e-6)


def test_ports_without_a_comb_of_their_own_are_refused() -> None:
    assert NrWaveform(comb=12).combs([(c, p) for c in range(6) for p in (0, 1)]) == list(range(12))
    with pytest.raises(InputError, match="6 ports share a comb of 4"):
        NrWaveform(comb=4, symbols=4).combs(PORTS)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"resource_blocks": 120}, "LTE has 6 to 110"),
        ({"technology": "nr", "resource_blocks": 136}, r"132 \(50 MHz\), 272 .*numerology 1.*set radio.front_end"),
        ({"technology": "nr", "resource_blocks": 272, "prs_comb": 6}, "prs_symbols equal to prs_comb"),
        ({"technology": "pilot_tones:PilotTones"}, "has no statistics of its detector"),
        ({"technology": "nr", "front_end": "signal", "prs_comb": 5}, "comb 5 is not one of 2, 4, 6, 12"),
        ({"technology": "umts"}, "technology"),
        ({"technology": "nowhere:At", "front_end": "signal"}, "'nowhere:At' cannot be loaded"),
        ({"technology": "pilot_tones:Other", "front_end": "signal"}, "'pilot_tones:Other' cannot be loaded"),
    ],
)
def test_wrong_keys_are_refused(keys: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        RadioConfig(**keys).waveform()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("slot_s", 1e-3, "slot_s = 0.001 is longer than 0.0005"),
        ("bandwidth_hz", 1e6, "reach over more than bandwidth_hz"),
        ("tones_hz", np.arange(-9e6, 9e6, 240e3), "delays repeat every 1249 m, within the search window of 1750 m"),
        ("tones_hz", np.zeros((2, 2)), "not two or more ascending"),
        ("values", lambda self, port, comb, slot: np.ones(3), r"values have shape \(3,\)"),
        ("values", lambda self, port, comb, slot: np.full(200, 2.0), "not all of magnitude 1"),
        ("slots", 0, "slots = 0"),
    ],
)
def test_what_is_wrong_with_a_waveform_is_said(name: str, value: object, text: str) -> None:
    mistaken = type("Mistaken", (type(own()),), {name: value})
    with pytest.raises(InputError, match=text):
        checked(mistaken(None), 1750.0)
    with pytest.raises(InputError, match="Fraction is no waveform: it lacks slot_s"):
        checked(Fraction(1, 2), 1750.0)
