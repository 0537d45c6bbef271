"""Reference signals against check values and against the specification written out bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.lte import reference_signal
from cellslam.sim.lte.downlink import LteWaveform, c_init, first_subcarrier, subcarrier_frequency_hz
from tests.sim.waveform.test_pseudo_random import serial_gold

CHECK = [
    (375, 6152943, (3, 0, 0), "++----+-", "-++---++"),
    (179, 2941287, (5, 2, 2), "+----+-+", "+---+-++"),
]


def signs(values: np.ndarray) -> str:
    return "".join("+" if v > 0 else "-" for v in values)


@pytest.mark.parametrize(("cell", "seed", "first", "real", "imaginary"), CHECK)
def test_check_values(cell: int, seed: int, first: tuple[int, ...], real: str, imaginary: str) -> None:
    port_0, port_1 = reference_signal(cell, 0, 0), reference_signal(cell, 1, 0)
    assert c_init(cell, 0, 0) == seed
    assert signs(port_0.values[:8].real) == real
    assert signs(port_0.values[:8].imag) == imaginary
    k0 = port_0.subcarriers[0], port_1.subcarriers[0], port_0.subcarriers[port_0.symbols == 4][0]
    assert k0 == first


# v of clause 6.10.1.2, written out: (port, l == 0, slot odd) -> v; ports 2 and 3 have only l = 1.
SHIFT = {
    (0, True, 0): 0, (0, True, 1): 0, (0, False, 0): 3, (0, False, 1): 3,
    (1, True, 0): 3, (1, True, 1): 3, (1, False, 0): 0, (1, False, 1): 0,
    (2, False, 0): 0, (2, False, 1): 3, (3, False, 0): 3, (3, False, 1): 6,
}  # fmt: skip
SYMBOLS = {
    ("normal", 0): [0, 4], ("normal", 1): [0, 4], ("normal", 2): [1], ("normal", 3): [1],
    ("extended", 0): [0, 3], ("extended", 1): [0, 3], ("extended", 2): [1], ("extended", 3): [1],
}  # fmt: skip


@pytest.mark.parametrize("prefix", ["normal", "extended"])
@pytest.mark.parametrize("port", [0, 1, 2, 3])
@pytest.mark.parametrize(("cell", "slot", "blocks"), [(0, 0, 100), (503, 19, 7), (178, 12, 110)])
def test_agrees_with_the_specification(prefix: str, port: int, cell: int, slot: int, blocks: int) -> None:
    got = reference_signal(cell, port, slot, blocks, prefix)
    rows = []
    for symbol in SYMBOLS[prefix, port]:
        n_cp = int(prefix == "normal")
        seed = 2**10 * (7 * (slot + 1) + symbol + 1) * (2 * cell + 1) + 2 * cell + n_cp
        c = serial_gold(seed, 440)
        shift = (SHIFT[port, symbol == 0, slot % 2] + cell % 6) % 6
        for m in range(2 * blocks):
            at = m + 110 - blocks
            value = complex(1 - 2 * c[2 * at], 1 - 2 * c[2 * at + 1]) / 2**0.5
            rows.append((symbol, 6 * m + shift, value))
    assert got.symbols.tolist() == [r[0] for r in rows]
    assert got.subcarriers.tolist() == [r[1] for r in rows]
    np.testing.assert_allclose(got.values, [r[2] for r in rows], atol=1e-15)


def test_cells_that_collide() -> None:
    combs = {cell: LteWaveform().combs([(cell, 0), (cell, 1)]) for cell in (375, 376, 377, 177, 178, 179, 378)}
    assert all(combs[a] == combs[b] for a, b in ((375, 177), (376, 178), (377, 179)))
    assert not {*combs[375]} & {*combs[376]}
    assert combs[378] == combs[375][::-1]
    assert first_subcarrier(375, 0, 0, 0) == 3


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((504, 0, 0), "cell ID 504"),
        ((1, 4, 0), "antenna port 4"),
        ((1, 0, 20), "slot 20"),
        ((1, 0, 0, 111), "resource_blocks 111"),
        ((1, 0, 0, 100, "short"), "'short' is unknown"),
    ],
)
def test_bad_arguments_are_refused(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(InputError, match=text):
        reference_signal(*arguments)  # type: ignore[arg-type]


def test_the_carrier_is_left_out() -> None:
    # The middle of a band of 6 blocks, and its ends.
    assert subcarrier_frequency_hz([0, 35, 36, 37, 71], 6).tolist() == [-36 * 15e3, -15e3, 15e3, 30e3, 36 * 15e3]
