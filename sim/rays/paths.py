"""The ray tracer's answer: one row a path, in flat columns."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
MAX_ORDER = 2


@dataclass(frozen=True)
class Paths:
    """Paths (P,), sorted by receiver, transmitter, order, facets; world frame, isotropic antennas.

    `receiver`, `transmitter` index what was traced; `order` counts reflections; `facets` (P, 2), from the
    transmitter on, -1 none; `points_m` (P, 2, 3), the specular points, NaN none; `vt_position_m` (P, 3), the
    image from which the path seems to come; `length_m`; arrival angles as seen from the receiver towards the
    VT, departure angles as seen from the transmitter; `gain` (P, 2, 2) complex: row the receiver's and column
    the transmitter's (H, V) polarisation, each H and V being the unit vectors of growing azimuth and
    elevation of that end's own direction; free space and reflections included, propagation phase exp(-2j pi
    length / wavelength) left out.
    """

    receiver: Ints
    transmitter: Ints
    order: Ints
    facets: Ints
    points_m: Floats
    vt_position_m: Floats
    length_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    departure_azimuth_rad: Floats
    departure_elevation_rad: Floats
    gain: NDArray[np.complex128]

    def __len__(self) -> int:
        return len(self.receiver)

    @property
    def gain_db(self) -> Floats:
        """Power gain (P,) in dB: what both polarisations receive of a unit vertical transmission."""
        power = (np.abs(self.gain[:, :, 1]) ** 2).sum(axis=1)
        return np.asarray(10.0 * np.log10(np.maximum(power, 1e-300)), np.float64)

    def take(self, rows: NDArray[Any]) -> Paths:
        """Return the paths of an index or a mask over rows."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def concatenate(pieces: list[Paths]) -> Paths:
    """Return the paths of all pieces, in their order; at least one piece."""
    return Paths(**{f.name: np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Paths)})
