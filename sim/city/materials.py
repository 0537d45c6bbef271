"""Building materials of ITU-R P.2040-3, Table 3: eps_r = a f^b, sigma = c f^d with f in GHz, sigma in S/m."""

from __future__ import annotations

from cellslam.sim.city.city import REFERENCE_HZ, Material
from cellslam.sim.errors import unknown_name

# name: (a, b, c, d)
ITU_P2040: dict[str, tuple[float, float, float, float]] = {
    "vacuum": (1.0, 0.0, 0.0, 0.0),
    "concrete": (5.24, 0.0, 0.0462, 0.7822),
    "brick": (3.91, 0.0, 0.0238, 0.16),
    "plasterboard": (2.73, 0.0, 0.0085, 0.9395),
    "wood": (1.99, 0.0, 0.0047, 1.0718),
    "glass": (6.31, 0.0, 0.0036, 1.3394),
    "ceiling_board": (1.48, 0.0, 0.0011, 1.0750),
    "chipboard": (2.58, 0.0, 0.0217, 0.7800),
    "plywood": (2.71, 0.0, 0.33, 0.0),
    "marble": (7.074, 0.0, 0.0055, 0.9262),
    "floorboard": (3.66, 0.0, 0.0044, 1.3515),
    "metal": (1.0, 0.0, 1e7, 0.0),
    "very_dry_ground": (3.0, 0.0, 0.00015, 2.52),
    "medium_dry_ground": (15.0, -0.1, 0.035, 1.63),
    "wet_ground": (30.0, -0.4, 0.15, 1.30),
}

# Walls as they are usually built; None: so thick that nothing comes back from the far side.
THICKNESS_M: dict[str, float | None] = {"concrete": 0.25, "brick": 0.30, "glass": 0.012, "metal": None, "wood": 0.10}


def itu_name(name: str) -> str:
    """Return the name of a material in the table, of what files call it: `mat-itu_brick`."""
    return name.removeprefix("mat-").removeprefix("itu_").removeprefix("itu-")


def itu_material(name: str, thickness_m: float | None = None, roughness_m: float = 0.0) -> Material:
    """Return a material of ITU-R P.2040-3 by its name there. Raises InputError for an unknown name."""
    if name not in ITU_P2040:
        raise unknown_name("material", name, ITU_P2040)
    a, b, c, d = ITU_P2040[name]
    f_ghz = REFERENCE_HZ / 1e9
    return Material(name, a * f_ghz**b, c * f_ghz**d, roughness_m, thickness_m, b, d)
