"""Diffuse multipath: clusters of weak scatterers behind every path, fixed in space.

Each path is followed by a cluster whose power falls exponentially with the excess delay. A cluster belongs to a VT and
a cell of a 20 m grid on the ground: within the cell the scatterers are virtual transmitters that stand still, so that
their fading follows the motion.

Source: own model, docs/explanation/front-end.md, "Channel".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import azimuth_elevation, unit_vector
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.recording import Floats

SCATTERERS = 64  # of a cluster, at the bandwidth of LTE
GRID_M = 20.0
DECAY_M, LONGEST_M = 35.0, 150.0
AZIMUTH_STD_RAD, ELEVATION_STD_RAD = np.radians(12.0), np.radians(6.0)


@dataclass(frozen=True)
class Surroundings:
    """Where a trial's diffuse energy comes from: `entropy` seeds every cluster, `ratio_db` is specular over diffuse;
    `scatterers` of a cluster: so many that no receiver tells them apart.
    """

    entropy: int
    ratio_db: float
    scatterers: int = SCATTERERS

    def add(self, paths: PathColumns, sites: int, position_m: Floats) -> PathColumns:
        """Return the paths of one snapshot, each followed by its scatterers; `position_m` (3,) of the receiver in m."""
        count = len(paths.vt_m)
        if not count:
            return paths
        ground = np.floor(position_m[:2] / GRID_M).astype(np.int64)
        anchor = np.array([*(ground + 0.5) * GRID_M, position_m[2]])
        clusters = [self._cluster(vt, gain, ground, anchor) for vt, gain in zip(paths.vt_m, paths.gain, strict=True)]
        vt = np.concatenate([np.vstack([v, c[0]]) for v, c in zip(paths.vt_m, clusters, strict=True)])
        gain = np.concatenate([np.concatenate([g[None], c[1]]) for g, c in zip(paths.gain, clusters, strict=True)])
        departure = np.repeat(paths.departure_rad, self.scatterers + 1, axis=0)
        return PathColumns(paths.rows * (self.scatterers + 1), vt, gain, departure)

    def _cluster(
        self, vt: Floats, gain: np.ndarray[tuple[int, ...], np.dtype[np.complex128]], ground: np.ndarray, anchor: Floats
    ) -> tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[np.complex128]]]:
        place = [round(float(x) * 100.0) & 0xFFFFFFFF for x in vt]
        where = [int(x) & 0xFFFFFFFF for x in ground]
        rng = np.random.default_rng([self.entropy, *place, *where])
        excess = -DECAY_M * np.log1p(np.expm1(-LONGEST_M / DECAY_M) * rng.random(self.scatterers))
        azimuth, elevation = azimuth_elevation(vt - anchor)
        turned = unit_vector(
            azimuth + AZIMUTH_STD_RAD * rng.standard_normal(self.scatterers),
            np.clip(elevation + ELEVATION_STD_RAD * rng.standard_normal(self.scatterers), -1.5, 1.5),
        )
        reach = np.linalg.norm(vt - anchor) + excess
        # The mean power over what is sent and received equals that of the path over the ratio.
        level = np.linalg.norm(gain) / 2.0 * np.sqrt(10.0 ** (-self.ratio_db / 10.0) / self.scatterers)
        normal = rng.standard_normal((self.scatterers, 2, 2, 2)) / np.sqrt(2.0)
        return anchor + reach[:, None] * turned, level * (normal[..., 0] + 1j * normal[..., 1])
