"""Compiled link budget: sector antenna, array, polarisation; powers in milliwatt per resource element.

Source: 3GPP TR 36.814, Table A.2.1.1-2 (sector antenna); TR 38.901, Table 7.3-1 (element of the array).
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical.detector_layout import Array, LinkTable, PathColumns


@part
def sector_gain(azimuth: float, elevation: float, cell_azimuth: float, cell_tilt: float) -> float:
    """Return the relative power gain of a sector antenna (TR 36.814, Table A.2.1.1-2); tilt is downwards."""
    off = math.degrees(wrap(azimuth - cell_azimuth))
    down = math.degrees(-elevation - cell_tilt)
    horizontal = min(12.0 * (off / 70.0) ** 2, 25.0)
    vertical = min(12.0 * (down / 10.0) ** 2, 20.0)
    return float(10.0 ** (-0.1 * min(horizontal + vertical, 25.0)))


@njit(cache=True)
def array_gain(elevation: float) -> float:
    """Return the mean power gain of the array's ports: TR 38.901 Table 7.3-1, 16 columns, two slants."""
    return float(10.0 ** (-0.1 * (2.16 + min(12.0 * (math.degrees(elevation) / 65.0) ** 2, 30.0))))


@njit(cache=True)
def path_power(gain: Array, slant: Array) -> float:
    """Return the power of both received polarisations for unit power sent with `slant`; gain[rx, tx]."""
    h = gain[0, 0] * slant[0] + gain[0, 1] * slant[1]
    v = gain[1, 0] * slant[0] + gain[1, 1] * slant[1]
    return float(h.real**2 + h.imag**2 + v.real**2 + v.imag**2)


@part
def link_powers(
    paths: PathColumns, base: int, geo: Array, links: LinkTable, eirp: float, power: Array, cell_power: Array
) -> None:
    """Write `power` (L, W) per link and path in mW, and `cell_power` (C,), the mean over a cell's ports of its total.

    `base`: first row of `paths.rows` of this snapshot; `geo` (S, W, 3) as `body_geometry` writes it.
    """
    for cell in range(len(cell_power)):
        cell_power[cell] = 0.0
    for link in range(len(links.site)):
        site, cell = links.site[link], links.cell[link]
        first = paths.rows[base + site]
        for i in range(paths.rows[base + site + 1] - first):
            p = first + i
            away = paths.departure_rad[p]
            sector = sector_gain(away[0], away[1], links.cell_azimuth[cell], links.cell_tilt[cell])
            received = path_power(paths.gain[p], links.slant[link]) * sector * array_gain(geo[site, i, 2])
            power[link, i] = eirp * received
            cell_power[cell] += power[link, i] / links.cell_ports[cell]
