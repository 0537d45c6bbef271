"""The procedural city: streets, blocks, houses of varied height and material, ground."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import LineString, Polygon

from cellslam.sim.city.assemble import assemble, cap, prism, walls
from cellslam.sim.city.city import GROUND, City, Floats
from cellslam.sim.city.city_config import ProceduralCityConfig
from cellslam.sim.city.materials import THICKNESS_M, itu_material
from cellslam.sim.city.procedural.houses import (
    POLE_HEIGHT_M,
    blocks_between,
    closed_block,
    open_block,
    pole_plans,
    with_bays,
)
from cellslam.sim.city.procedural.street_network import street_network
from cellslam.sim.errors import InputError

GROUND_MARGIN_M = 300.0
SHOP_HEIGHT_M = 4.0


def generate(config: ProceduralCityConfig, rng: np.random.Generator) -> City:
    """Return a city drawn from `rng`; the same state of `rng` gives the same city."""
    streets = street_network(config, rng)
    lines = [LineString(line) for line in streets]
    widths = [config.street_width_m * float(rng.choice([1.0, 1.0, 1.25, 1.6])) for _ in lines]
    footprints = [p for block in blocks_between(lines, widths) for p in _fill(block, config, rng)]
    if not footprints:
        raise InputError(
            f"the generated city has no building: block_size_m {config.block_size_m}, "
            f"square_share {config.square_share}, open_coverage {config.open_coverage} leave no room; "
            "enlarge blocks or lower square_share"
        )
    heights = _heights(len(footprints), config, rng)
    names = sorted(config.material_weights)
    weights = np.array([config.material_weights[name] for name in names])
    choice = rng.choice(len(names), size=len(footprints), p=weights / weights.sum())
    used = [*names, "concrete", "medium_dry_ground", "glass", "metal"]
    materials = [itu_material(n, THICKNESS_M.get(n), config.roughness_m) for n in used]
    roof, ground, glass, metal = range(len(names), len(used))
    # Details have a stream of their own: a city without them is the same, whatever they need.
    details = rng.spawn(1)[0]
    if config.bay_share > 0.0:
        footprints = with_bays(footprints, config, details)
    shops = details.random(len(footprints)) < config.shop_share
    poles = pole_plans(streets, widths, footprints, config) if config.pole_spacing_m > 0.0 else []
    half = config.extent_m / 2 + GROUND_MARGIN_M
    parts = [cap(shapely.box(-half, -half, half, half), 0.0, ground, GROUND)]
    for building, (plan, height) in enumerate(zip(footprints, heights, strict=True)):
        shop_m = SHOP_HEIGHT_M if shops[building] and height > 1.5 * SHOP_HEIGHT_M else 0.0
        if shop_m > 0.0:
            parts.append(walls(plan, 0.0, shop_m, glass, building))
        parts += prism(plan, shop_m, height, int(choice[building]), roof, building)
    for building, plan in enumerate(poles, len(footprints)):
        parts += prism(plan, 0.0, POLE_HEIGHT_M, metal, metal, building)
    heights = np.concatenate([heights, np.full(len(poles), POLE_HEIGHT_M)])
    known = materials if poles or shops.any() else materials[:glass]
    return assemble("procedural", parts, known, [*footprints, *poles], heights, streets)


def _fill(block: Polygon, config: ProceduralCityConfig, rng: np.random.Generator) -> list[Polygon]:
    kind = rng.random()
    if kind < config.square_share:
        return []
    if kind < config.square_share + (1.0 - config.square_share) * config.open_share:
        return open_block(block, config, rng)
    return closed_block(block, config, rng)


def _heights(count: int, config: ProceduralCityConfig, rng: np.random.Generator) -> Floats:
    """Draw heights to the decimetre: mostly in the middle of the range, a few towers."""
    low, high = config.height_min_m, config.height_max_m
    height = low + (high - low) * rng.beta(2.0, 2.0, count)
    tower = rng.random(count) < config.tower_share
    height = np.where(tower, config.tower_height_m * rng.uniform(0.85, 1.15, count), height)
    return np.asarray(np.round(height, 1), np.float64)
