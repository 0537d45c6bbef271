"""Points that scatter: where they stand on the walls of a city, and the paths by way of them.

A point p of cross section sigma takes a share of the power that a transmitter t sends and scatters it to all sides. The
path to a receiver r exists where both straight ways are free,

    length       |t - p| + |p - r|,    direction of arrival that of p - r
    power gain   (lambda / 4 pi)^2 sigma / (4 pi |t - p|^2 |p - r|^2)

without a change of polarisation, and sigma is the same to all sides. A point stands a little in front of its wall:
what juts out of facades scatters, bays, balconies, frames and corners. Half of the points stand at the ends of walls,
from where they see both streets. It is received within a region around it (visibility region, Molisch et al., "The COST
259 directional channel model, part I", IEEE Trans. Wireless Communications 5(12), 2006), here of 100 m; radius, height,
stand-off and share at corners are own assumptions.

Source: the bistatic radar equation, Skolnik, "Introduction to radar systems", 3rd ed., 2001. Cross sections, own
assumption: 15 dBsm, which is about that of a corner reflector of half a metre at 2.66 GHz, 4 pi a^4 / (3 lambda^2)
(Knott, Shaeffer and Tuley, "Radar cross section", 2nd ed., 2004), with a deviation of 5 dB.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.city.city import GROUND, Floats, Ints
from cellslam.sim.described import Described
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation
from cellslam.sim.rays.paths import Paths
from cellslam.sim.rays.scene import Scene

FIRST = -2  # what stands for scatterer 0 in the second column of `Paths.facets`; -3 for scatterer 1, and so on
MEAN_DBSM, STD_DB = 15.0, 5.0
STAND_OFF_M = 0.3
AT_CORNERS = 0.5
STEEP = 0.1  # sine of how far a wall leans at most
REACH_M = 100.0  # from farther off a scatterer is not received: the radius of the region in which it is visible


@dataclass(frozen=True, repr=False)
class Scatterers(Described):
    """Points that scatter: `position_m` (n, 3) in the world frame, `cross_section_m2` (n,)."""

    position_m: Floats
    cross_section_m2: Floats

    def __len__(self) -> int:
        return len(self.position_m)


def scatterer_of(facets: Ints) -> Ints:
    """Return the scatterer (P,) that the paths with facets (P, 2) come from, -1 none."""
    return np.where(facets[:, 1] <= FIRST, FIRST - facets[:, 1], -1)


def draw_scatterers(scene: Scene, per_100_m: float, rng: np.random.Generator) -> Scatterers:
    """Draw points on the walls of a scene, on average so many for 100 m of wall, at any height of the wall."""
    facets = scene.city.facets
    walls = np.flatnonzero((np.abs(facets.normal[:, 2]) < STEEP) & (facets.building != GROUND) & scene.reflects)
    table = scene.table[walls]
    left, right, low, high = table[:, 10:14].T
    length = right - left
    count = rng.poisson(per_100_m * length.sum() / 100.0)
    wall = rng.choice(len(walls), count, p=length / length.sum()) if count else np.empty(0, np.int64)
    along, up, corner = rng.random((3, count))
    along = np.where(corner < AT_CORNERS, np.round(along), along)
    u = left[wall] + along * length[wall]
    v = low[wall] + up * (high - low)[wall]
    own = table[wall]
    position = (own[:, 3:4] + STAND_OFF_M) * own[:, :3] + u[:, None] * own[:, 4:7] + v[:, None] * own[:, 7:10]
    return Scatterers(position + scene.origin_m, 10.0 ** (0.1 * (MEAN_DBSM + STD_DB * rng.standard_normal(count))))


def scattered_paths(
    scatterers: Scatterers, scene: Scene, transmitters_m: Floats, receivers_m: Floats, carrier_hz: float
) -> list[Paths]:
    """Return the paths from each transmitter (S, 3) to receivers (R, 3), in m, by way of one scatterer: those that no
    building blocks."""
    position = scatterers.position_m
    illuminated = np.stack([scene.free(np.broadcast_to(t, position.shape), position) for t in transmitters_m])
    which, receiver = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for k in np.flatnonzero(illuminated.any(axis=0)):
        near = np.flatnonzero(((receivers_m - position[k]) ** 2).sum(axis=1) < REACH_M**2)
        seen = near[scene.free(receivers_m[near], np.broadcast_to(position[k], (len(near), 3)))]
        which.append(np.full(len(seen), k))
        receiver.append(seen)
    point, row = np.concatenate(which), np.concatenate(receiver)
    out = []
    for site, transmitter in enumerate(transmitters_m):
        own = illuminated[site, point]
        out.append(_described(site, transmitter, receivers_m, scatterers, point[own], row[own], carrier_hz))
    return out


def _described(
    site: int, transmitter: Floats, receivers_m: Floats, scatterers: Scatterers, which: Ints, row: Ints,
    carrier_hz: float,
) -> Paths:  # fmt: skip
    """Return the paths (n,) by way of scatterers `which` (n,) to receivers `row` (n,)."""
    position, receiver, count = scatterers.position_m[which], receivers_m[row], len(which)
    before, after = np.linalg.norm(position - transmitter, axis=1), np.linalg.norm(position - receiver, axis=1)
    wavelength = SPEED_OF_LIGHT_MPS / carrier_hz
    spread = np.sqrt(scatterers.cross_section_m2[which] / (4.0 * np.pi)) / (before * after)
    arrival, departure = azimuth_elevation(position - receiver), azimuth_elevation(position - transmitter)
    none, nowhere = np.full(count, -1, np.int64), np.full_like(position, np.nan)
    return Paths(
        receiver=row, transmitter=np.full(count, site, np.int64), order=np.ones(count, np.int64),
        facets=np.column_stack([none, FIRST - which]), edge=none, points_m=np.stack([position, nowhere], axis=1),
        vt_position_m=receiver + (position - receiver) * ((before + after) / after)[:, None], length_m=before + after,
        azimuth_rad=arrival[0], elevation_rad=arrival[1],
        departure_azimuth_rad=departure[0], departure_elevation_rad=departure[1],
        gain=(wavelength / (4.0 * np.pi) * spread)[:, None, None] * np.eye(2, dtype=np.complex128),
    )  # fmt: skip
