"""Base-station sites: their cells and antennas' directions, and where they stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellslam.sim.city import City
from cellslam.sim.city.inside import roof_height
from cellslam.sim.errors import InputError
from cellslam.sim.vehicle import Route

Floats = NDArray[np.float64]

NEAREST_M, FARTHEST_M = 60.0, 220.0
"""Distances from the route at which a site is placed by itself."""
APART_M = 150.0
"""Sites that are placed by themselves keep this distance from each other."""
LOWEST_M, HIGHEST_M = 35.0, 45.0
"""Heights of their antennas above the road; on roofs at least ABOVE_ROOF_M above the roof."""
ABOVE_ROOF_M = 4.0
DRAWS = 400
PLACES = 10
"""Places drawn for a site, of which the best is taken."""
SAMPLES, SAMPLE_HEIGHT_M = 60, 1.8
"""Points of the route at which places are compared, and their height above the road."""


class CellConfig(BaseModel):
    """One sector of a site."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cell_id: int = Field(ge=0, le=503, description="physical cell ID")
    azimuth_deg: float = Field(0.0, ge=-360.0, le=360.0, description="boresight, counter-clockwise from east")
    tilt_deg: float = Field(8.0, ge=-10.0, le=45.0, description="tilt of the main lobe below the horizon")


class SiteConfig(BaseModel):
    """A base-station site: a position, or none to have it placed near the route, and its cells."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1, description="name of the site")
    position_m: tuple[float, float, float] | None = Field(
        None,
        description="antenna position [x, y, z] in metres; absent: drawn near the route in each trial",
    )
    cells: tuple[CellConfig, ...] = Field(min_length=1, description="sectors of the site")
    ports: int = Field(2, ge=1, le=4, description="CRS antenna ports per cell, each a link of its own")
    # What is not known is left out, so that a world without surveyed sites is called what it was before there were any.
    known: bool = Field(
        False,
        exclude_if=lambda known: not known,
        description="whether estimators know, by a survey, where the site is and where its sectors point",
    )
    survey_std_m: float = Field(
        0.0,
        ge=0.0,
        le=1000.0,
        exclude_if=lambda std: std == 0.0,
        description="deviation of the survey's error in x, in y and in z, drawn for each trial, m; 0: exact",
    )

    @model_validator(mode="after")
    def _is_known_if_surveyed(self) -> Self:
        """Refuse the error of a survey that estimators do not know."""
        if self.survey_std_m > 0.0 and not self.known:
            raise ValueError(f"survey_std_m = {self.survey_std_m:g} of a site that is not known: add known = true")
        return self


def place_sites(
    city: City, route: Route, sites: Sequence[SiteConfig], rng: np.random.Generator, within_m: Floats | None = None
) -> Floats:
    """Return the antenna positions (S, 3) in m; those not given are drawn near the route, on masts and roofs.

    `within_m`: lower and upper corner (2, 2) of where they may be drawn; None: anywhere.

    Raises InputError, naming site, value and roof height, where a given position is inside a building.
    """
    names = [s.name for s in sites]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"site name '{name}' is given {names.count(name)} times: each site needs a name of its own"
            )
    placed = [_checked(city, s) for s in sites if s.position_m is not None]
    out = []
    for site in sites:
        if site.position_m is not None:
            out.append(np.array(site.position_m, np.float64))
        else:
            placed.append(_drawn(city, route, site, placed, rng, within_m))
            out.append(placed[-1])
    return np.array(out, np.float64).reshape(-1, 3)


def _checked(city: City, site: SiteConfig) -> Floats:
    assert site.position_m is not None
    x, y, z = site.position_m
    if z <= city.road_m:
        at = f"site '{site.name}': position_m = [{x:g}, {y:g}, {z:g}]"
        raise InputError(f"{at} is not above ground (z must be > {city.road_m:g})")
    roof = roof_height(city, x, y)
    if z <= roof:
        raise InputError(
            f"site '{site.name}': position_m = [{x:g}, {y:g}, {z:g}] is inside a building, "
            f"whose roof is at {roof:.1f} m there: raise the site above the roof or move it"
        )
    return np.array(site.position_m, np.float64)


def _drawn(
    city: City,
    route: Route,
    site: SiteConfig,
    placed: Sequence[Floats],
    rng: np.random.Generator,
    within_m: Floats | None,
) -> Floats:
    """Return, of some possible places, the one from which most paths reach the route, as a planner would."""
    from cellslam.sim.rays import trace

    places = _possible_places(city, route, placed, rng, within_m)
    if not len(places):
        raise InputError(
            f"no place for site '{site.name}' was found {NEAREST_M:g} to {FARTHEST_M:g} m beside the route and "
            f"{APART_M:g} m from the other sites: give its position_m"
        )
    foot = route.points_m[:: max(len(route.points_m) // SAMPLES, 1)]
    paths = trace(city, places, np.column_stack([foot, np.full(len(foot), city.road_m + SAMPLE_HEIGHT_M)]))
    return np.asarray(places[int(np.argmax(np.bincount(paths.transmitter, minlength=len(places))))])


def _possible_places(
    city: City, route: Route, placed: Sequence[Floats], rng: np.random.Generator, within_m: Floats | None
) -> Floats:
    """Return up to PLACES positions (n, 3) beside the route, apart from `placed`, on masts or on lower roofs."""
    places: list[Floats] = []
    for _ in range(DRAWS):
        foot = route.points_m[int(rng.integers(len(route.points_m)))]
        angle, distance = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(NEAREST_M, FARTHEST_M)
        x, y = foot + distance * np.array([np.cos(angle), np.sin(angle)])
        height = city.road_m + rng.uniform(LOWEST_M, HIGHEST_M)
        if np.hypot(*(route.points_m - (x, y)).T).min() < NEAREST_M:
            continue
        if within_m is not None and ((within_m[0] > (x, y)) | (within_m[1] < (x, y))).any():
            continue
        if any(np.hypot(*(other[:2] - (x, y))) < APART_M for other in placed):
            continue
        if roof_height(city, float(x), float(y)) + ABOVE_ROOF_M <= height:
            places.append(np.array([x, y, height]))
        if len(places) == PLACES:
            break
    return np.array(places).reshape(-1, 3)
