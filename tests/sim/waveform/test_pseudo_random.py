"""The Gold sequence against worked numbers, and against two registers clocked bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.waveform.pseudo_random import gold_sequence, qpsk


def serial_gold(seed: int, length: int) -> list[int]:
    """Clause 7.2 of TS 36.211, two registers held as integers and clocked one bit at a time."""
    x1, x2, out = 1, seed, []
    for n in range(1600 + length):
        if n >= 1600:
            out.append((x1 ^ x2) & 1)
        x1 |= ((x1 ^ (x1 >> 3)) & 1) << 31
        x2 |= ((x2 ^ (x2 >> 1) ^ (x2 >> 2) ^ (x2 >> 3)) & 1) << 31
        x1, x2 = x1 >> 1, x2 >> 1
    return out


@pytest.mark.parametrize(
    ("seed", "first"),
    [
        (0, "00000010000110100001001001111010"),
        (1234, "11000001011011000010010111111010"),
        (2**31 - 1, "11111101000010111111001110001110"),
    ],
)
def test_worked_numbers(seed: int, first: str) -> None:
    assert "".join(map(str, gold_sequence(seed, 32))) == first


def test_it_is_the_two_registers() -> None:
    for length in (1, 31, 440, 29_000):
        assert gold_sequence(99_615_167, length).tolist() == serial_gold(99_615_167, length)


def test_bit_pairs_are_the_four_corners() -> None:
    corners = qpsk(np.array([0, 0, 0, 1, 1, 0, 1, 1], np.int8)) * np.sqrt(2.0)
    np.testing.assert_allclose(corners, [1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
