"""In which slots a positioning reference signal is sent: period, repetition, muting.

Source: 3GPP TS 38.211, clause 7.4.1.7.4; TS 38.214, clause 5.1.6.5; values, TS 37.355 and TS 38.455.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.nr.prs import NUMEROLOGIES, check_integers, slots_per_frame

FRAMES = 1024  # after which the system frame number begins again
PERIODS = (4, 5, 8, 10, 16, 20, 32, 40, 64, 80, 160, 320, 640, 1280, 2560, 5120, 10240)  # at 15 kHz
REPETITIONS = (1, 2, 4, 6, 8, 16, 32)
GAPS = (1, 2, 4, 8, 16, 32)
MUTING_LENGTHS = (2, 4, 6, 8, 16, 32)
MUTING_REPETITIONS = (1, 2, 4, 8)
LAST_RESOURCE_OFFSET = 511


def prs_slots(
    numerology: int,
    period: int,
    slots: int,
    offset: int = 0,
    resource_offset: int = 0,
    repetition: int = 1,
    gap: int = 1,
    muting: Sequence[int] = (),
    muting_repetition: int = 1,
    repetition_muting: Sequence[int] = (),
) -> NDArray[np.int64]:
    """Return the slots (N,), counted from the first of frame 0, of the first `slots` in which a resource is sent.

    `period` and `offset` of the resource set in slots; `resource_offset` of the resource within its set; `repetition`:
    how many times it is sent in a period, every `gap` slots. `muting` (bits, 1: sent) goes on by one bit with every
    `muting_repetition` periods (option 1), `repetition_muting` has a bit for each repetition in a period (option 2);
    where both are given, both must be 1.

    Raises InputError, naming what is allowed, for a value out of its range and for repetitions longer than the period.
    """
    _check(numerology, period, slots, offset, resource_offset, repetition, gap)
    _check_muting(repetition, muting, muting_repetition, repetition_muting)
    number = np.arange(slots, dtype=np.int64)
    # TS 38.211, clause 7.4.1.7.4: slots since T_offset of the resource set and T_offset,res of the resource in it.
    since = number - offset - resource_offset
    # The same: of a period T_per the slots {i T_gap}, i = 0 to T_rep - 1.
    which, between = np.divmod(since % period, gap)
    sent = (between == 0) & (which < repetition)
    if len(muting):  # The same, muting option 1: bit floor(n / (T_mut T_per)) mod L of the set's first bitmap.
        sent &= np.asarray(muting, bool)[since // (muting_repetition * period) % len(muting)]
    if len(
        repetition_muting
    ):  # The same, option 2: bit floor((n mod T_per) / T_gap) mod L of the second; both must be 1.
        sent &= np.asarray(repetition_muting, bool)[which % repetition]
    return np.asarray(number[sent], np.int64)


def _check(
    numerology: int, period: int, slots: int, offset: int, resource_offset: int, repetition: int, gap: int
) -> None:
    """Raise InputError for what is out of its range (TS 37.355, NR-DL-PRS-ResourceSet), and for what does not fit."""
    check_integers({"numerology": (numerology, 0, NUMEROLOGIES - 1)})
    periods = [2**numerology * p for p in PERIODS]
    _check_choice(f"period at numerology {numerology}:", period, periods)
    _check_choice("repetition", repetition, REPETITIONS)
    _check_choice("gap", gap, GAPS)
    check_integers({
        "slots": (slots, 0, FRAMES * slots_per_frame(numerology)),
        "offset": (offset, 0, period - 1),
        "resource_offset": (resource_offset, 0, LAST_RESOURCE_OFFSET),
    })  # fmt: skip
    if (repetition - 1) * gap >= period:
        raise InputError(
            f"{repetition} repetitions every {gap} slots last longer than the period of {period}: "
            f"repetition may be up to {max(r for r in REPETITIONS if (r - 1) * gap < period)} with this gap"
        )


def _check_muting(
    repetition: int, muting: Sequence[int], muting_repetition: int, repetition_muting: Sequence[int]
) -> None:
    """Raise InputError for bitmaps that are none (TS 38.214, clause 5.1.6.5: option 2: a bit for each repetition)."""
    _check_choice("muting_repetition", muting_repetition, MUTING_REPETITIONS)
    _check_choice("muting of length", len(muting), (0, *MUTING_LENGTHS))
    _check_choice("repetition_muting of length", len(repetition_muting), (0, repetition) if repetition > 1 else (0,))
    for name, bits in (("muting", muting), ("repetition_muting", repetition_muting)):
        if any(bit not in (0, 1) for bit in bits):
            raise InputError(f"{name} {list(bits)} has other bits than 0 (muted) and 1 (sent)")


def _check_choice(name: str, value: int, allowed: Sequence[int]) -> None:
    if not isinstance(value, (int, np.integer)) or value not in allowed:
        raise InputError(f"{name} {value} is not one of {', '.join(map(str, allowed))}")
