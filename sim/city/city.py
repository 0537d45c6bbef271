"""The city as ray tracer, maps and vehicle see it: triangles, planar facets, footprints, streets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described

if TYPE_CHECKING:
    from shapely import Polygon, STRtree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
GROUND = -1
REFERENCE_HZ = 2.66e9


@dataclass(frozen=True)
class Material:
    """Electrical properties of a wall: relative permittivity and conductivity (S/m) at 2.66 GHz.

    `roughness_m` is the standard deviation of the surface height; `thickness_m` None means a half space. At
    another carrier the properties follow f ** exponent (ITU-R P.2040-3, equations 28 and 29).
    """

    name: str
    eps_r: float
    sigma_spm: float
    roughness_m: float = 0.0
    thickness_m: float | None = None
    eps_exponent: float = 0.0
    sigma_exponent: float = 0.0

    def at(self, carrier_hz: float) -> tuple[float, float]:
        """Return relative permittivity and conductivity (S/m) at a carrier in Hz."""
        ratio = carrier_hz / REFERENCE_HZ
        return self.eps_r * ratio**self.eps_exponent, self.sigma_spm * ratio**self.sigma_exponent


@dataclass(frozen=True, repr=False)
class Facets(Described):
    """Planar pieces of surface: normal (F, 3) and offset (F,) with normal . x = offset, in metres.

    `area_m2` (F,); `material` (F,) indexes `City.materials`; `building` (F,) indexes `City.footprints`, -1 is
    ground; `planarity_m` (F,) is the largest distance of one of its vertices from the plane.
    """

    normal: Floats
    offset: Floats
    area_m2: Floats
    material: Ints
    building: Ints
    planarity_m: Floats

    def __len__(self) -> int:
        return len(self.offset)


@dataclass(frozen=True)
class Tolerances:
    """How far a corner may lie from a facet's plane in metres, and how far a triangle may turn from it in degrees."""

    plane_m: float = 2e-3
    angle_deg: float = 1.0


TOLERANCES = Tolerances()


@dataclass(frozen=True, repr=False)
class City(Described):
    """A city in local metres (east, north, up).

    `vertices` (V, 3); `triangles` (K, 3) into vertices; `triangle_facet` (K,); one footprint and one height
    above its base per building; `streets`: centre lines, each (n, 2), that share their end points where they
    meet; `notes` tells what loading repaired or dropped; `tolerances` those with which triangles became facets.
    `origin_deg`: longitude and latitude (WGS 84) of the zero, of a file that is in these; None: not known.
    `road_m`: height at which vehicles drive.
    """

    name: str
    vertices: Floats
    triangles: Ints
    triangle_facet: Ints
    facets: Facets
    materials: tuple[Material, ...]
    footprints: tuple[Polygon, ...]
    heights_m: Floats
    streets: tuple[Floats, ...] = ()
    notes: tuple[str, ...] = ()
    tolerances: Tolerances = TOLERANCES
    origin_deg: tuple[float, float] | None = None
    road_m: float = 0.0

    @property
    def bounds(self) -> Floats:
        """Lower and upper corner (2, 3) of all vertices, in metres."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def plans(self) -> STRtree:
        """The triangles' boxes as seen from above, to look up which lie over or under a point."""
        import shapely

        plan = self.vertices[self.triangles][:, :, :2]
        (west, south), (east, north) = plan.min(axis=1).T, plan.max(axis=1).T
        return shapely.STRtree(shapely.box(west, south, east, north))
