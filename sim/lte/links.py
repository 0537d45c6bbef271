"""The links of a world: one row per base-station cell and reference-signal port.

Source: slants of +-45 degrees, cross-polarised elements of 3GPP TR 38.901, clause 7.3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.lte.statistical.detector_layout import LinkTable
from cellslam.sim.recording import Floats, Ints, Links


@dataclass(frozen=True)
class Cells:
    """Sector cells (C,): site, cell ID, boresight azimuth (world, counter-clockwise from east), downtilt, ports."""

    site: Ints
    cell_id: Ints
    azimuth_rad: Floats
    tilt_rad: Floats
    ports: Ints


def cells_of(sites: Sequence[Any]) -> Cells:
    """Return the cells of site configurations in their order. Raises InputError where two cells share an ID."""
    rows = [(s, cell, site.ports) for s, site in enumerate(sites) for cell in site.cells]
    ids = [cell.cell_id for _, cell, _ in rows]
    for cell_id in ids:
        if ids.count(cell_id) > 1:
            raise InputError(f"cell ID {cell_id} is given twice in sites: every cell needs its own")
    return Cells(
        site=np.array([s for s, _, _ in rows], np.int64),
        cell_id=np.array(ids, np.int64),
        azimuth_rad=np.radians(np.array([cell.azimuth_deg for _, cell, _ in rows], np.float64)),
        tilt_rad=np.radians(np.array([cell.tilt_deg for _, cell, _ in rows], np.float64)),
        ports=np.array([ports for _, _, ports in rows], np.int64),
    )


def links_of(cells: Cells) -> Links:
    """Return the recording's link table: every port of every cell, in the order of the cells."""
    table = link_table(cells)
    return Links(site=table.site, cell_id=cells.cell_id[table.cell], port=table.port)


def slant(port: NDArray[np.int64]) -> Floats:
    """Return the ports' polarisations (..., 2) as (H, V) amplitudes, unit vectors: +45 deg if even, -45 if odd."""
    h = np.where(port % 2 == 0, 1.0, -1.0)
    return np.asarray(np.stack([h, np.ones_like(h)], axis=-1) / np.sqrt(2.0))


def link_table(cells: Cells) -> LinkTable:
    """Return the arrays that the compiled detector reads."""
    cell = np.repeat(np.arange(len(cells.site)), cells.ports)
    port = np.concatenate([np.empty(0, np.int64), *map(np.arange, cells.ports)])
    return LinkTable(
        site=cells.site[cell],
        cell=cell,
        port=port,
        slant=slant(port),
        cell_site=cells.site,
        cell_ports=cells.ports,
    )
