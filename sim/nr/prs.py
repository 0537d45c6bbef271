"""Downlink positioning reference signal of NR: what is sent in a slot, and in which slots.

Source: 3GPP TS 38.211, clauses 7.4.1.7.2 (sequence), 7.4.1.7.3 (resource elements) and 7.4.1.7.4 (slots); ranges, TS
38.214, clause 5.1.6.5, TS 37.355 and TS 38.455.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.waveform.pseudo_random import gold_sequence, qpsk
from cellslam.sim.waveform.waveform import ReferenceSignal, check_integers

CyclicPrefix = Literal["normal", "extended"]
SYMBOLS_PER_SLOT = {"normal": 14, "extended": 12}
SEQUENCE_IDS, NUMEROLOGIES = 4096, 4
FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS, BLOCK_STEP = 24, 272, 4
LAST_FIRST_BLOCK = 2176
LAST_FIRST_SYMBOL = 12
SUBCARRIERS_PER_BLOCK = 12
# k' of TS 38.211, Table 7.4.1.7.3-1: by how many subcarriers the comb is moved in each symbol, over and over.
STAGGER = {2: (0, 1), 4: (0, 2, 1, 3), 6: (0, 3, 1, 4, 2, 5), 12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11)}
# Symbols of a resource that go with each comb (TS 38.211, clause 7.4.1.7.3).
LENGTHS = {2: (2, 4, 6, 12), 4: (4, 12), 6: (6, 12), 12: (12,)}
FRAMES = 1024  # after which the system frame number begins again
PERIODS = (4, 5, 8, 10, 16, 20, 32, 40, 64, 80, 160, 320, 640, 1280, 2560, 5120, 10240)  # at 15 kHz
REPETITIONS = (1, 2, 4, 6, 8, 16, 32)
GAPS = (1, 2, 4, 8, 16, 32)
MUTING_LENGTHS = (2, 4, 6, 8, 16, 32)
MUTING_REPETITIONS = (1, 2, 4, 8)
LAST_RESOURCE_OFFSET = 511


def positioning_reference_signal(
    sequence_id: int,
    slot: int,
    numerology: int,
    resource_blocks: int,
    comb: int,
    symbols: int,
    first_symbol: int = 0,
    element_offset: int = 0,
    first_block: int = 0,
    cyclic_prefix: CyclicPrefix = "normal",
) -> ReferenceSignal:
    """Return the positioning reference signal of one resource in a slot of the frame (TS 38.211, clause 7.4.1.7).

    `sequence_id`: dl-PRS-SequenceID; `numerology`: 0 to 3 for 15 to 120 kHz; `comb` and `symbols`: every how many
    subcarriers, and in how many symbols from `first_symbol` on, it is sent; `element_offset`: first subcarrier of the
    comb; `first_block`: dl-PRS-StartPRB. Subcarriers count from Point A, values have unit power.

    Raises InputError, naming what is allowed, for a value out of its range and for a combination that is not specified.
    """
    _check(sequence_id, slot, numerology, resource_blocks, comb, symbols, first_symbol, element_offset, first_block)
    if cyclic_prefix not in SYMBOLS_PER_SLOT or (cyclic_prefix == "extended" and numerology != 2):
        raise InputError(
            f"cyclic prefix '{cyclic_prefix}' at numerology {numerology}: normal, or extended at numerology 2"
        )
    in_slot = SYMBOLS_PER_SLOT[cyclic_prefix]
    if first_symbol + symbols > in_slot:
        raise InputError(
            f"symbols = {symbols} from first_symbol {first_symbol} do not fit into a slot of {in_slot}: "
            f"first_symbol must be 0 to {in_slot - symbols}"
        )
    # m counts from Point A, not from the first block (clause 7.4.1.7.3).
    first = first_block * SUBCARRIERS_PER_BLOCK // comb
    count = resource_blocks * SUBCARRIERS_PER_BLOCK // comb
    m = np.arange(first, first + count, dtype=np.int64)
    subcarriers, values = [], []
    for i in range(symbols):
        subcarriers.append(m * comb + (element_offset + STAGGER[comb][i % comb]) % comb)
        bits = gold_sequence(c_init(sequence_id, slot, first_symbol + i, cyclic_prefix), 2 * (first + count))
        values.append(qpsk(bits[2 * first :]))
    number = first_symbol + np.repeat(np.arange(symbols, dtype=np.int64), count)
    return ReferenceSignal(number, np.concatenate(subcarriers), np.concatenate(values))


def slots_per_frame(numerology: int) -> int:
    """Return the number of slots in a frame of 10 ms (TS 38.211, Table 4.3.2-1)."""
    return int(10 * 2**numerology)


def c_init(sequence_id: int, slot: int, symbol: int, cyclic_prefix: CyclicPrefix = "normal") -> int:
    """Return the seed of the pseudo-random sequence in a symbol (TS 38.211, clause 7.4.1.7.2)."""
    high, low = divmod(sequence_id, 1024)
    elapsed = SYMBOLS_PER_SLOT[cyclic_prefix] * slot + symbol + 1
    return (2**22 * high + 2**10 * elapsed * (2 * low + 1) + low) % 2**31


def _check(
    sequence_id: int, slot: int, numerology: int, resource_blocks: int, comb: int, symbols: int, first_symbol: int,
    element_offset: int, first_block: int,
) -> None:  # fmt: skip
    check_integers({
        "numerology": (numerology, 0, NUMEROLOGIES - 1),
        "sequence_id": (sequence_id, 0, SEQUENCE_IDS - 1),
        "first_symbol": (first_symbol, 0, LAST_FIRST_SYMBOL),
        "first_block": (first_block, 0, LAST_FIRST_BLOCK),
    })  # fmt: skip
    check_integers({"slot": (slot, 0, slots_per_frame(numerology) - 1)})
    check_resource_blocks(resource_blocks)
    check_comb(comb, symbols)
    check_integers({f"element_offset of comb {comb}:": (element_offset, 0, comb - 1)})


def check_resource_blocks(resource_blocks: int) -> None:
    """Raise InputError for a bandwidth that no positioning reference signal has."""
    check_integers({"resource_blocks": (resource_blocks, FEWEST_RESOURCE_BLOCKS, MOST_RESOURCE_BLOCKS)})
    if resource_blocks % BLOCK_STEP:
        raise InputError(
            f"resource_blocks {resource_blocks} is not one of {FEWEST_RESOURCE_BLOCKS}, "
            f"{FEWEST_RESOURCE_BLOCKS + BLOCK_STEP}, ..., {MOST_RESOURCE_BLOCKS}"
        )


def check_comb(comb: int, symbols: int) -> None:
    """Raise InputError for a comb that is none, and for a number of symbols that does not go with it."""
    _check_choice("comb", comb, tuple(LENGTHS))
    if not isinstance(symbols, (int, np.integer)) or symbols not in LENGTHS[comb]:
        raise InputError(f"symbols {symbols} do not go with comb {comb}: {' or '.join(map(str, LENGTHS[comb]))} do")


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
    _check_schedule(numerology, period, slots, offset, resource_offset, repetition, gap)
    _check_muting(repetition, muting, muting_repetition, repetition_muting)
    number = np.arange(slots, dtype=np.int64)
    # TS 38.211, clause 7.4.1.7.4: slots since T_offset of the resource set and T_offset,res of the resource in it.
    since = number - offset - resource_offset
    # The same: of a period T_per the slots {i T_gap}, i = 0 to T_rep - 1.
    which, between = np.divmod(since % period, gap)
    sent = (between == 0) & (which < repetition)
    # The same, muting option 1: bit floor(n / (T_mut T_per)) mod L of the set's first bitmap.
    if len(muting):
        sent &= np.asarray(muting, bool)[since // (muting_repetition * period) % len(muting)]
    # The same, option 2: bit floor((n mod T_per) / T_gap) mod L of the second; both must be 1.
    if len(repetition_muting):
        sent &= np.asarray(repetition_muting, bool)[which % repetition]
    return np.asarray(number[sent], np.int64)


def _check_schedule(
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
