"""The positioning reference signal against the clauses written out element by element."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.nr import positioning_reference_signal
from tests.sim.waveform.test_pseudo_random import serial_gold

# TS 38.211, Table 7.4.1.7.3-1: k' of the symbols l - l_start = 0, 1, ..., 11.
K_PRIME = {
    2: (0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1),
    4: (0, 2, 1, 3, 0, 2, 1, 3, 0, 2, 1, 3),
    6: (0, 3, 1, 4, 2, 5, 0, 3, 1, 4, 2, 5),
    12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11),
}
PAIRS = ((2, 2), (4, 2), (6, 2), (12, 2), (4, 4), (12, 4), (6, 6), (12, 6), (12, 12))  # (L_PRS, K_comb)
CORNER = np.sqrt(0.5)


def plain(
    n: int, slot: int, blocks: int, comb: int, length: int, l_start: int, k_offset: int, first_block: int, in_slot: int
) -> list[tuple[int, int, complex]]:
    """Walk over all subcarriers from Point A that lie on the comb, two bits of the sequence at each."""
    rows = []
    for symbol in range(l_start, l_start + length):
        seed = (n // 1024 << 22) + 1024 * (in_slot * slot + symbol + 1) * (2 * (n % 1024) + 1) + n % 1024
        shift = (k_offset + K_PRIME[comb][symbol - l_start]) % comb
        on_comb = [k for k in range(12 * (first_block + blocks)) if k % comb == shift]
        c = serial_gold(seed % 2**31, 2 * len(on_comb))
        for m, k in enumerate(on_comb):
            if k >= 12 * first_block:
                rows.append((symbol, k, complex(CORNER * (1 - 2 * c[2 * m]), CORNER * (1 - 2 * c[2 * m + 1]))))
    return rows


@pytest.mark.parametrize(("length", "comb"), PAIRS)
def test_every_comb_agrees_with_the_clauses(length: int, comb: int) -> None:
    """Each offset of the comb, all else drawn at random."""
    rng = np.random.default_rng(8)
    for k_offset in range(comb):
        numerology, n, blocks = int(rng.integers(4)), int(rng.integers(4096)), 4 * int(rng.integers(6, 12))
        prefix = "extended" if numerology == 2 else "normal"
        in_slot = 14 if prefix == "normal" else 12
        slot, l_start = int(rng.integers(10 * 2**numerology)), int(rng.integers(min(in_slot - length, 12) + 1))
        first_block = int(rng.choice([0, 3, 500]))
        got = positioning_reference_signal(
            n, slot, numerology, blocks, comb, length, l_start, k_offset, first_block,
            prefix,  # type: ignore[arg-type]
        )  # fmt: skip
        expected = plain(n, slot, blocks, comb, length, l_start, k_offset, first_block, in_slot)
        assert got.symbols.tolist() == [r[0] for r in expected]
        assert got.subcarriers.tolist() == [r[1] for r in expected]
        np.testing.assert_allclose(got.values, [r[2] for r in expected], atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((4096, 0, 1, 24, 2, 2), "sequence_id 4096 is not an integer from 0 to 4095"),
        ((0, 20, 1, 24, 2, 2), "slot 20 is not an integer from 0 to 19"),
        ((0, 0, 1, 24, 3, 6), "comb 3 is not one of 2, 4, 6, 12"),
        ((0, 0, 1, 24, 12, 6), "symbols 6 do not go with comb 12: 12 do"),
        ((0, 0, 1, 24, 6, 6, 9), "first_symbol must be 0 to 8"),
        ((0, 0, 1, 24, 4, 4, 0, 4), "element_offset of comb 4: 4 is not an integer from 0 to 3"),
        ((0, 0, 1, 24, 4, 4, 0, 0, 0, "extended"), "normal, or extended at numerology 2"),
    ],
)
def test_bad_arguments_are_refused(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(InputError, match=text):
        positioning_reference_signal(*arguments)  # type: ignore[arg-type]
