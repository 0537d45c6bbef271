"""From particles to what is told of the map: that of one particle.

Source: Thrun, Burgard and Fox, "Probabilistic robotics", 2005, chapter 13 (each particle of FastSLAM has a map).
"""

from __future__ import annotations

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.state.copy_kernel import read_map
from cellslam.slam.fastslam.state.layout import LANES
from cellslam.slam.fastslam.state.particles import Particles
from cellslam.slam.fastslam.state.tracks_kernel import CONFIRMED


def map_of(particles: Particles, index: int, parts: Parts, site_of: Ints, origin: Floats) -> VtEstimate:
    """Return the confirmed VTs of one particle, in the world frame, in m; `origin` (3,): where the filter's lies.

    site_of (L,): site of each link, which has a map.
    """
    block, lane = divmod(index, LANES)
    read = read_map(parts)
    return VtEstimate(*read(parts, block, lane, CONFIRMED, particles.nuisances, particles.held, site_of, origin))
