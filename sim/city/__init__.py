"""Cities: meshes in, planar facets out. `build_city` is the door; the heavy parts load when it is called."""

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
