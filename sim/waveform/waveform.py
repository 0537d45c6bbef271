"""Reference signals as they are handed out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ReferenceSignal(NamedTuple):
    """Reference elements of one port in one slot, by symbol, then subcarrier: all (N,).

    `symbols`: OFDM symbol in the slot; `subcarriers`: index from the first of the carrier's grid; `values`: complex, of
    magnitude 1.
    """

    symbols: NDArray[np.int64]
    subcarriers: NDArray[np.int64]
    values: NDArray[np.complex128]
