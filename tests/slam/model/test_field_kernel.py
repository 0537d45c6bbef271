"""Fields of direction: unit variance everywhere, the correlation asked for, the same cell whichever way it is met."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.frames import unit_vector
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.field_kernel import MOST_BELLS, Grid, bells, grid

GRIDS = [grid(np.radians(15.0), 1.1, 1.9), grid(np.radians(4.0), 1.2, 1.9), grid(np.radians(40.0), 1.1, 1.9)]


def met(g: Grid, azimuth: float, elevation: float) -> tuple[Ints, Floats]:
    cells, values = np.zeros(MOST_BELLS, np.int64), np.zeros(MOST_BELLS)
    count = bells(g, azimuth, elevation, cells, values)
    return cells[:count], values[:count]


def row(g: Grid, azimuth: float, elevation: float) -> Floats:
    out = np.zeros(g.cells)
    cells, values = met(g, azimuth, elevation)
    np.add.at(out, cells, values)
    return out


def directions(count: int) -> Floats:
    rng = np.random.default_rng(0)
    return np.stack([rng.uniform(-np.pi, np.pi, count), np.arcsin(rng.uniform(-1.0, 1.0, count))], axis=1)


@pytest.mark.parametrize("g", GRIDS)
def test_variance_is_one_and_no_cell_is_met_twice(g: Grid) -> None:
    for azimuth, elevation in [*directions(300), (0.0, np.pi / 2), (2.0, -np.pi / 2), (np.pi, 0.0), (-np.pi, 0.3)]:
        cells, values = met(g, azimuth, elevation)
        assert 0 < len(cells) < MOST_BELLS
        assert len(set(cells.tolist())) == len(cells)
        assert (cells >= 0).all() and (cells < g.cells).all()
        assert values @ values == pytest.approx(1.0)


@pytest.mark.parametrize("g", GRIDS)
def test_correlation_is_the_squared_exponential(g: Grid) -> None:
    rng, worst = np.random.default_rng(1), 0.0
    for azimuth, elevation in directions(300):
        other = np.clip(elevation + rng.normal() * g.scale, -1.5, 1.5)
        aside = azimuth + rng.normal() * g.scale / max(np.cos(elevation), 0.2)
        chord = np.linalg.norm(unit_vector(azimuth, elevation) - unit_vector(aside, other))
        found = row(g, azimuth, elevation) @ row(g, aside, other)
        worst = max(worst, abs(found - np.exp(-0.5 * (chord / g.scale) ** 2)))
    assert worst < 0.12


def test_turns_of_azimuth_make_no_difference() -> None:
    g = GRIDS[1]
    for azimuth, elevation in directions(50):
        np.testing.assert_allclose(row(g, azimuth, elevation), row(g, azimuth + 2 * np.pi, elevation), atol=1e-12)
