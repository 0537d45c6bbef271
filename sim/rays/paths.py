"""The ray tracer's answer: one row a path, in flat columns.

Source: image method, which gives the virtual transmitters of the extended FastSLAM paper, section III.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.described import Described
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
MAX_ORDER = 2
DIFFRACTED = MAX_ORDER + 1


@dataclass(frozen=True, repr=False)
class Paths(Described):
    """Paths (P,), sorted by receiver, transmitter, order, facets; world frame, isotropic antennas.

    `receiver`, `transmitter` index what was traced; `order` counts reflections, a diffraction or scattering being one
    more; `facets` (P, 2), from the transmitter on, -1 none, -2 and below a vehicle (`sim/traffic/obstacles.py`), in the
    second column a scatterer (`scattering`); `edge` (P,), the diffracting edge of `Scene.edges`, -1 none; `points_m`
    (P, 2, 3), the specular or scattering points, NaN none; `vt_position_m` (P, 3), the image from which the path seems
    to come (of a diffracted or scattered path it moves with the receiver); `length_m`; arrival angles as seen from the
    receiver towards the VT, departure angles as seen from the transmitter; `gain` (P, 2, 2) complex: row the receiver's
    and column the transmitter's (H, V) polarisation, each H and V being the unit vectors of growing azimuth and
    elevation of that end's own direction; free space and
    reflections included, propagation phase exp(-2j pi length / wavelength) left out.
    """

    receiver: Ints
    transmitter: Ints
    order: Ints
    facets: Ints
    edge: Ints
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
    def kind(self) -> Ints:
        """Kind (P,) of each path: its number of reflections, or `DIFFRACTED`."""
        return np.where(self.edge >= 0, DIFFRACTED, self.order)

    @property
    def gain_db(self) -> Floats:
        """Power gain (P,) in dB: what both polarisations receive of a unit vertical transmission."""
        power = (np.abs(self.gain[:, :, 1]) ** 2).sum(axis=1)
        return np.asarray(10.0 * np.log10(np.maximum(power, 1e-300)), np.float64)

    def doppler_hz(self, velocity_mps: ArrayLike, carrier_hz: float) -> Floats:
        """Return the Doppler shift (P,) in Hz for receivers' world velocities (N, 3), or one (3,) for all of them.

        Positive where the receiver approaches the image: f = (v . e) / wavelength with e from receiver to VT.
        """
        velocity = np.asarray(velocity_mps, np.float64)
        own = velocity if velocity.ndim == 1 else velocity[self.receiver]
        cos = np.cos(self.elevation_rad)
        towards = [cos * np.cos(self.azimuth_rad), cos * np.sin(self.azimuth_rad), np.sin(self.elevation_rad)]
        closing = (np.stack(towards, axis=1) * own).sum(axis=1)
        return np.asarray(closing * carrier_hz / SPEED_OF_LIGHT_MPS, np.float64)

    def take(self, rows: NDArray[Any]) -> Paths:
        """Return the paths of an index (n,) or a mask (P,) over rows."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True)
class Found:
    """Free paths (P,) of one transmitter, as the searches find them: the receiver's `row`, `facets` (P, 2) and
    `points` (P, 2, 3) of up to two interactions in centred coordinates, the diffracting `edge`; -1 and NaN none.
    """

    row: Ints
    facets: Ints
    points: Floats
    edge: Ints

    @staticmethod
    def of(row: Ints, facets: Ints | None = None, points: Floats | None = None, edge: Ints | None = None) -> Found:
        """Return paths of up to two facets (P, n) and points (P, m, 3), in m; what is missing is filled up."""
        both, where = np.full((len(row), 2), -1, np.int64), np.full((len(row), 2, 3), np.nan)
        if facets is not None:
            both[:, : facets.shape[1]] = facets
        if points is not None:
            where[:, : points.shape[1]] = points
        return Found(row, both, where, np.full(len(row), -1, np.int64) if edge is None else edge)

    def take(self, rows: NDArray[Any]) -> Found:
        """Return the paths of an index (n,) over rows."""
        return Found(self.row[rows], self.facets[rows], self.points[rows], self.edge[rows])


def all_found(pieces: list[Found]) -> Found:
    """Return the paths of all pieces."""
    return Found(*(np.concatenate([getattr(piece, f.name) for piece in pieces]) for f in fields(Found)))


def joined(pieces: list[Paths]) -> Paths:
    """Return the paths of all pieces in the order of `Paths`; at least one piece. Empties the list.

    A column at a time, as many millions of paths would else be there twice.
    """
    columns = {f.name: [getattr(p, f.name) for p in pieces] for f in fields(Paths)}
    pieces.clear()
    whole = {name: np.concatenate(columns.pop(name)) for name in list(columns)}
    facets = whole["facets"]
    keys = (whole["edge"], facets[:, 1], facets[:, 0], whole["order"], whole["transmitter"], whole["receiver"])
    rows = np.lexsort(keys)
    for name in whole:
        whole[name] = whole[name][rows]
    return Paths(**whole)
