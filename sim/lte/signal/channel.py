"""The channel of a snapshot: traced paths at the array, diffuse energy behind them, and what they give the tones.

Diffuse multipath is a cluster of weak scatterers behind every path, fixed in space. Its power falls exponentially with
the excess delay. A cluster belongs to a VT and a cell of a 20 m grid on the ground: within the cell the scatterers are
virtual transmitters that stand still, so that their fading follows the motion.

Source: the extended FastSLAM paper, section II, equations 2 to 4; diffuse multipath: own model,
docs/explanation/front-end.md, "Channel".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation, rotation, unit_vector
from cellslam.sim.lte.array import Complex, PathSet
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.rays.gain import polarisation_basis
from cellslam.sim.recording import Floats

SCATTERERS = 64  # of a cluster, at the bandwidth of LTE
GRID_M = 20.0
DECAY_M, LONGEST_M = 35.0, 150.0
AZIMUTH_STD_RAD, ELEVATION_STD_RAD = np.radians(12.0), np.radians(6.0)


def arriving_paths(
    pose: Floats, vt_m: Floats, gain: Complex, slant: Floats, amplitude: Floats, carrier_hz: float
) -> PathSet:
    """Return the paths (n,) of one transmit port in the body frame of `pose` (6,); m and rad.

    `vt_m` (n, 3); `gain` (n, 2, 2) [received, sent] in the (H, V) of the world frame; `slant` (2,) of the
    transmit port; `amplitude` (n,) in sqrt(mW): radiated power and sector antenna. Weights carry the
    propagation phase, and are turned into the (H, V) of the body frame.
    """
    towards = vt_m - pose[:3]
    distance = np.linalg.norm(towards, axis=1)
    body = towards @ rotation(*pose[3:])
    world_basis, body_basis = (np.stack(polarisation_basis(v / distance[:, None]), axis=1) for v in (towards, body))
    turn = np.einsum("npi,ij,nqj->nqp", world_basis, rotation(*pose[3:]), body_basis)
    phase = np.exp(-2j * np.pi * distance * carrier_hz / SPEED_OF_LIGHT_MPS)
    weights = (amplitude * phase)[:, None] * np.einsum("nqp,npr,r->nq", turn, gain, slant)
    return PathSet(distance, *azimuth_elevation(body), weights)


@dataclass(frozen=True)
class Surroundings:
    """Where a trial's diffuse energy comes from: `entropy` seeds every cluster, `ratio_db` is specular over diffuse;
    `scatterers` of a cluster: so many that no receiver tells them apart.
    """

    entropy: int
    ratio_db: float
    scatterers: int = SCATTERERS

    def add(self, paths: PathColumns, position_m: Floats) -> PathColumns:
        """Return the paths of one snapshot, each followed by its scatterers; `position_m` (3,) of the receiver in m."""
        if not len(paths.vt_m):
            return paths
        ground = np.floor(position_m[:2] / GRID_M).astype(np.int64)
        anchor = np.array([*(ground + 0.5) * GRID_M, position_m[2]])
        clusters = [self._cluster(vt, gain, ground, anchor) for vt, gain in zip(paths.vt_m, paths.gain, strict=True)]
        vt, gain = (np.concatenate(parts) for parts in zip(*clusters, strict=True))
        departure = np.repeat(paths.departure_rad, self.scatterers + 1, axis=0)
        return PathColumns(paths.rows * (self.scatterers + 1), vt, gain, departure)

    def _cluster(self, vt: Floats, gain: Complex, ground: np.ndarray, anchor: Floats) -> tuple[Floats, Complex]:
        """Return positions (1 + scatterers, 3) and gains (1 + scatterers, 2, 2) of a path and its scatterers."""
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
        scattered = level * (normal[..., 0] + 1j * normal[..., 1])
        return np.vstack([vt, anchor + reach[:, None] * turned]), np.concatenate([gain[None], scattered])
