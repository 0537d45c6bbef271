"""What a city consists of, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.city.city import City, Floats
from cellslam.sim.city.facets import triangle_normals, weld


@dataclass(frozen=True)
class Summary:
    """Counts of a city. `low_m`, `high_m` (3,): its extent; `area_m2` by material, in descending order.

    `degenerate`: triangles without area, which cast shadows but reflect nothing; `copies`: triangles that are there
    more than once; `open_edges`: edges of one triangle only, where surfaces are not closed; `planarity_m`: largest
    distance of a vertex from its facet's plane.
    """

    name: str
    low_m: Floats
    high_m: Floats
    buildings: int
    vertices: int
    triangles: int
    facets: int
    area_m2: dict[str, float]
    streets_m: float
    degenerate: int
    copies: int
    open_edges: int
    planarity_m: float
    plane_tolerance_m: float
    angle_tolerance_deg: float
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        size = self.high_m - self.low_m
        low, high = (f"({', '.join(f'{c:.1f}' for c in corner)})" for corner in (self.low_m, self.high_m))
        total = sum(self.area_m2.values())
        shares = (f"{name} {area:.0f} m2 ({100.0 * area / total:.0f} %)" for name, area in self.area_m2.items())
        lines = [
            f"city       {self.name}",
            f"extent     {size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} m, from {low} to {high}",
            f"buildings  {self.buildings}",
            f"triangles  {self.triangles} of {self.vertices} vertices",
            f"facets     {self.facets} from {self.triangles} triangles: those that touch and lie in one plane to "
            f"{1e3 * self.plane_tolerance_m:g} mm and {self.angle_tolerance_deg:g} degrees are joined; "
            f"all within {1e3 * self.planarity_m:.2f} mm",
            f"surface    {', '.join(shares)}",
        ]
        if self.streets_m > 0.0:
            lines.append(f"streets    {self.streets_m / 1e3:.2f} km")
        wrong = [
            (self.degenerate, "triangles without area: they cast shadows, but reflect nothing"),
            (self.copies, "triangles are copies of others: paths count once"),
            (self.open_edges, "edges belong to one triangle only: surfaces are not closed, which does no harm"),
        ]
        lines += [f"note       {count} {text}" for count, text in wrong if count]
        return [*lines, *(f"note       {note}" for note in self.notes)]


def summarise(city: City) -> Summary:
    """Return the summary of a city."""
    corners = city.vertices[city.triangles]
    _, area = triangle_normals(corners)
    material = city.facets.material[city.triangle_facet]
    # Vertices weld within a building, as an edge between two objects of one building is not open.
    owner = np.zeros(len(city.vertices), np.int64)
    owner[city.triangles] = city.facets.building[city.triangle_facet][:, None] + 1
    label = np.sort(weld(city.vertices, owner)[city.triangles], axis=1)
    same = np.unique(label, axis=0)
    edges = np.sort(same[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, uses = np.unique(edges, axis=0, return_counts=True)
    by_material: dict[str, float] = {}
    for index, m in enumerate(city.materials):
        by_material[m.name] = by_material.get(m.name, 0.0) + float(area[material == index].sum())
    low, high = city.bounds
    return Summary(
        name=city.name,
        low_m=low,
        high_m=high,
        buildings=len(city.footprints),
        vertices=len(city.vertices),
        triangles=len(city.triangles),
        facets=len(city.facets),
        area_m2={name: a for name, a in sorted(by_material.items(), key=lambda item: -item[1]) if a > 0.0},
        streets_m=float(sum(np.hypot(*np.diff(line, axis=0).T).sum() for line in city.streets)),
        degenerate=int(np.count_nonzero(area == 0.0)),
        copies=len(label) - len(same),
        open_edges=int(np.count_nonzero(uses == 1)),
        planarity_m=float(city.facets.planarity_m.max()),
        plane_tolerance_m=city.tolerances.plane_m,
        angle_tolerance_deg=city.tolerances.angle_deg,
        notes=city.notes,
    )
