"""What a scenario offers, measured with the ray tracer: paths, lines of sight, virtual transmitters."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.world import WorldConfig

Floats = NDArray[np.float64]

COUNTED_SNAPSHOTS = 20
"""A VT counts if its path exists in at least this many snapshots of the drive."""
SAME_VT_M = 0.01


@dataclass(frozen=True)
class Facts:
    """The measured facts of one drive in one city; paths are true ones, detected or not.

    `links`: cells and ports; `paths_per_site`: mean number of paths per site and snapshot;
    `line_of_sight_share` of all sites and snapshots; `no_path_share` of snapshots without any path;
    `distinct_vts` of all sites that exist in 20 snapshots, those of lines of sight included;
    `longest_reflected_s`: longest unbroken life of a reflected one; `measurements_per_snapshot`: paths
    reported on all links, clutter included.
    """

    snapshots: int
    duration_s: float
    distance_m: float
    links: int
    paths_per_site: float
    line_of_sight_share: float
    no_path_share: float
    distinct_vts: int
    longest_reflected_s: float
    measurements_per_snapshot: float

    def rounded(self) -> dict[str, float]:
        """Return the facts by name as they are written down: two decimals."""
        return {name: round(value, 2) for name, value in asdict(self).items()}


def scenario_facts(config: WorldConfig, seed: int = 0, trial: int = 0) -> Facts:
    """Return the facts of one trial of a scenario. Raises InputError where its parts do not fit."""
    from cellslam.sim.world import prepare

    world = prepare(config, seed, trial)
    detections, paths, blocked = world.measure_drive(world.streams())
    paths = paths.take(blocked.free(len(paths)))
    links = sum(len(site.cells) * site.ports for site in config.sites)
    interval_s = config.vehicle.snapshot_interval_s
    return measure_facts(paths, world.drive.poses, interval_s, len(config.sites), links, len(detections.measurements))


def measure_facts(
    paths: Paths, poses: Floats, snapshot_interval_s: float, sites: int, links: int, measurements: int
) -> Facts:
    """Return the facts of a drive with true `poses` (T, 6), in m and rad, whose paths to all `sites` were traced."""
    snapshots = len(poses)
    keys = np.column_stack([paths.transmitter, paths.order, np.round(paths.vt_position_m / SAME_VT_M)])
    vts, vt = np.unique(keys, axis=0, return_inverse=True)
    vt = vt.reshape(-1)
    seen = np.bincount(vt, minlength=len(vts))
    lives = [longest_run(np.unique(paths.receiver[vt == i])) for i in np.flatnonzero(vts[:, 1] > 0)]
    return Facts(
        snapshots=snapshots,
        duration_s=snapshots * snapshot_interval_s,
        distance_m=float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
        links=links,
        paths_per_site=len(paths.receiver) / (sites * snapshots),
        line_of_sight_share=float(np.count_nonzero(paths.order == 0) / (sites * snapshots)),
        no_path_share=1.0 - len(np.unique(paths.receiver)) / snapshots,
        distinct_vts=int(np.count_nonzero(seen >= COUNTED_SNAPSHOTS)),
        longest_reflected_s=max(lives, default=0) * snapshot_interval_s,
        measurements_per_snapshot=measurements / snapshots,
    )


def longest_run(sorted_snapshots: NDArray[np.int64]) -> int:
    """Return the length of the longest run of consecutive numbers in `sorted_snapshots` (n,)."""
    breaks = np.flatnonzero(np.diff(sorted_snapshots) > 1)
    ends = np.concatenate([[-1], breaks, [len(sorted_snapshots) - 1]])
    return int(np.diff(ends).max(initial=0))
