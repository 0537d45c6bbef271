"""In which slots the signal is sent: slot by slot after the clause."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.nr import prs_slots
from cellslam.sim.nr.prs import GAPS, MUTING_LENGTHS, PERIODS, REPETITIONS


def sent(slot: int, period: int, shift: int, repetition: int, gap: int, muting: list[int], every: int, of_repetition:
         list[int]) -> bool:  # fmt: skip
    """Whether the resource is sent in one slot: each repetition tried in turn."""
    for i in range(repetition):
        begin = slot - shift - i * gap
        if begin % period == 0:
            instance = begin // period
            open_1 = not muting or muting[(instance // every) % len(muting)] == 1
            return open_1 and (not of_repetition or of_repetition[i] == 1)
    return False


def test_it_is_the_clause_slot_by_slot() -> None:
    rng, tried = np.random.default_rng(3), 0
    while tried < 200:
        numerology = int(rng.integers(4))
        period = 2**numerology * PERIODS[rng.integers(9)]
        repetition, gap = int(rng.choice(REPETITIONS)), int(rng.choice(GAPS))
        if (repetition - 1) * gap >= period:
            continue
        tried += 1
        offset, resource = int(rng.integers(period)), int(rng.integers(40))
        muting = rng.integers(0, 2, rng.choice((0, *MUTING_LENGTHS))).tolist()
        of_repetition = rng.integers(0, 2, repetition if repetition > 1 and rng.random() < 0.5 else 0).tolist()
        every = int(rng.choice((1, 2, 4, 8)))
        got = prs_slots(numerology, period, 900, offset, resource, repetition, gap, muting, every, of_repetition)
        shift = offset + resource
        assert got.tolist() == [
            slot for slot in range(900) if sent(slot, period, shift, repetition, gap, muting, every, of_repetition)
        ]


@pytest.mark.parametrize(
    ("numerology", "period", "more", "text"),
    [
        (1, 5, {}, "period at numerology 1: 5 is not one of 8, 10, 16"),
        (0, 10, {"offset": 10}, "offset 10 is not an integer from 0 to 9"),
        (0, 10, {"repetition": 4, "gap": 4}, "repetition may be up to 2 with this gap"),
        (0, 10, {"muting": [1, 0, 1]}, "muting of length 3 is not one of 0, 2, 4"),
        (0, 10, {"muting": [1, 2]}, "has other bits than"),
        (0, 10, {"repetition": 2, "repetition_muting": [1]}, "repetition_muting of length 1 is not one of 0, 2"),
    ],
)
def test_bad_arguments_are_refused(numerology: int, period: float, more: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        prs_slots(numerology, period, 40, **more)  # type: ignore[arg-type]
