"""Cities: a mesh file, or rules for a made-up one, in; a `City` of planar facets with materials out.

`build_city` is the door; what it needs loads when it is called: `files` reads meshes, `procedural` makes cities up,
`assemble` merges triangles to facets (`facets`), `inside` and `footprints` tell buildings, ground and open air apart.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.city.city import City, Facets, Material
from cellslam.sim.city.city_config import CityConfig, MeshCityConfig, ProceduralCityConfig

__all__ = ["City", "CityConfig", "Facets", "Material", "MeshCityConfig", "ProceduralCityConfig", "build_city"]


def build_city(config: ProceduralCityConfig | MeshCityConfig, rng: np.random.Generator) -> City:
    """Return the city of `config`; a mesh draws nothing from `rng`. Raises InputError for a bad mesh."""
    if isinstance(config, MeshCityConfig):
        from cellslam.sim.city.files.mesh import load_city

        return load_city(config)
    from cellslam.sim.city.procedural.generator import generate

    return generate(config, rng)
