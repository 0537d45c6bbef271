"""Sites: given positions are checked, absent ones are placed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

from cellslam.sim.city.assemble import assemble, prism
from cellslam.sim.city.inside import roof_height
from cellslam.sim.city.materials import itu_material
from cellslam.sim.errors import InputError
from cellslam.sim.lte.sites import CellConfig, SiteConfig, place_sites

CELL = (CellConfig(cell_id=1),)


@pytest.fixture(scope="module")
def city() -> Any:
    """A block of 25 m with a courtyard, between x, y = 100 and 140, and a tower of 60 m at the origin."""
    yard = shapely.box(100, 100, 140, 140).difference(shapely.box(115, 115, 125, 125))
    tower = shapely.box(-10, -10, 10, 10)
    parts = []
    for building, (plan, height) in enumerate(((yard, 25.0), (tower, 60.0))):
        parts += prism(plan, 0.0, height, material=0, roof=0, building=building)
    return assemble("two", parts, [itu_material("concrete", None, 0.0)], [yard, tower], np.array([25.0, 60.0]), [])


def route() -> Any:
    points = np.column_stack([np.linspace(-200.0, 300.0, 501), np.full(501, 60.0)])
    return SimpleNamespace(points_m=points)


def site(name: str = "A", position: tuple[float, float, float] | None = None) -> SiteConfig:
    return SiteConfig(name=name, position_m=position, cells=CELL)


@pytest.mark.parametrize(
    ("sites", "message"),
    [
        ([site("A", (0.0, 0.0, 70.0)), site("B", (105.0, 105.0, 20.0))],
         r"site 'B': position_m = \[105, 105, 20\] is inside a building, whose roof is at 25\.0 m"),
        ([site("A", (50.0, 50.0, -1.0))], "not above ground"),
        ([site("A"), site("A")], "name of its own"),
    ],
)  # fmt: skip
def test_impossible_sites_are_refused(city: Any, sites: list[SiteConfig], message: str) -> None:
    with pytest.raises(InputError, match=message):
        place_sites(city, route(), sites, np.random.default_rng(0))


def test_placed_sites_keep_their_distances(city: Any) -> None:
    for seed in range(10):
        placed = place_sites(
            city, route(), [site("A", (0.0, 0.0, 63.0)), site("B"), site("C")], np.random.default_rng(seed)
        )
        np.testing.assert_array_equal(placed[0], (0.0, 0.0, 63.0))  # given
        for x, y, z in placed[1:]:
            away = np.hypot(*(route().points_m - (x, y)).T).min()
            assert 60.0 <= away <= 220.0
            assert 35.0 <= z <= 45.0
            assert z >= roof_height(city, x, y) + 4.0
        between = np.linalg.norm(placed[:, None, :2] - placed[None, :, :2], axis=-1)
        assert between[np.triu_indices(3, 1)].min() >= 150.0


def test_the_error_of_a_survey_is_that_of_a_known_site() -> None:
    with pytest.raises(ValueError, match="survey_std_m = 2 of a site that is not known: add known = true"):
        SiteConfig(name="A", cells=CELL, survey_std_m=2.0)
    # What a world is called, and the rows of its drives are found by, is as it was before sites could be known.
    assert SiteConfig(name="A", cells=CELL).model_dump(mode="json").keys() == {"name", "position_m", "cells", "ports"}
    assert SiteConfig(name="A", cells=CELL, known=True).model_dump(mode="json")["known"] is True
