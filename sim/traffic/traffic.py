"""Other vehicles as boxes that move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.recording import Floats, Recording


@dataclass(frozen=True, repr=False)
class Traffic(Described):
    """Boxes on the ground: `kind` (N,) in words; `size_m` (N, 3) length, width, height; `time_s` (K,), equidistant;
    `poses` (K, N, 4): x, y, ground of the box's centre in m, yaw in rad, unwrapped; linear in between.
    """

    kind: tuple[str, ...]
    size_m: Floats
    time_s: Floats
    poses: Floats

    def __len__(self) -> int:
        return len(self.kind)

    def at(self, time_s: NDArray[np.floating[Any]]) -> Floats:
        """Return the poses (n, N, 4), in m and rad, at times (n,) in s; the ends are held."""
        from cellslam.sim.traffic.boxes_kernel import place

        out = np.empty((len(time_s), len(self), 4))
        for row, step in zip(out, self.steps(time_s), strict=True):
            place(self.poses, float(step), row)
        return out

    def steps(self, time_s: NDArray[np.floating[Any]]) -> Floats:
        """Return times (n,) in s as steps between the poses, without unit."""
        step_s = self.time_s[1] - self.time_s[0]
        return np.asarray((time_s - self.time_s[0]) / step_s)

    def outlines(self, time_s: Floats) -> Floats:
        """Return the corners (n, N, 4, 2) in m of the boxes seen from above, at times (n,) in s."""
        poses = self.at(time_s)
        half = 0.5 * self.size_m[:, None, :2] * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        c, s = np.cos(poses[..., 3])[..., None], np.sin(poses[..., 3])[..., None]
        turned = np.stack([c * half[..., 0] - s * half[..., 1], s * half[..., 0] + c * half[..., 1]], axis=-1)
        return np.asarray(poses[:, :, None, :2] + turned)


def traffic_of(recording: Recording) -> Traffic | None:
    """Return the traffic of a simulated drive, None without any."""
    found = None if recording.truth is None else recording.truth.vehicles
    return None if found is None else Traffic(found.kind, found.size_m, found.time_s, found.poses)
