"""Two images in one wall: how likely that is, and what it teaches a joint filter.

The planes that mirror two sites to two VTs differ by an azimuth and by a distance at a place between their visible
parts. If both are of one wall, the difference is zero but for how flat facades are; its covariance is that of the joint
state. Otherwise it is anything. The posterior odds of the two decide. What is believed is imposed as a measurement of
zero, once: the joint filter then is one whose landmark is the wall.

Sources: Leitinger, Venus, Teague and Meyer, IEEE Trans. Signal Processing 71, 2023, for walls that several sites
share; Simon, "Kalman filtering with state constraints", IET Control Theory and Applications 4(8), 2010, section 2.3,
for constraints as measurements; Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE
Trans. Automatic Control 38, 1993.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.state.layout import VT, Filter
from cellslam.slam.model.walls import mirror_plane, normals
from cellslam.slam.wall_slam.images import Image, place_of

# Walls that are next to each other differ by this much, if they differ: uniform in rad and m (either sign).
OTHER_RAD, OTHER_M = math.pi / 2, 25.0
GATE = 9.0  # squared Mahalanobis distance of what may be one wall
RIVAL = 3.0  # log-odds by which a pair must be likelier than another one of either image
ITERATIONS = 3
TURNED = 0.5  # walls whose directions differ by more than this, in rad, are not looked at


class Flatness(NamedTuple):
    """Of facades: by how much parts of one wall are turned (rad) and set off (m); gaps in them (m)."""

    turned: float
    off: float
    gap: float

    @property
    def covariance(self) -> Floats:
        """Of azimuth and distance, (2, 2), in rad^2 and m^2."""
        return np.diag([self.turned**2, self.off**2])


class Planes(NamedTuple):
    """Planes of n images: azimuth in rad and distance in m, `value` (n, 2), and Jacobian `by` (n, 2, 6) by the states
    of site and VT, which are `at` (n, 6)."""

    value: Floats
    at: Ints
    by: Floats

    def covariance(self, f: Filter) -> Floats:
        """Return the joint covariance (n, 2, n, 2) of the planes, in rad^2, rad m and m^2."""
        joint = f.p[self.at[:, :, None, None], self.at]
        return np.asarray(np.einsum("nai,nimj,mbj->namb", self.by, joint, self.by, optimize=True))


def planes_of(f: Filter, images: Sequence[Image], about: Floats) -> Planes:
    """Return the planes of images as seen from `about` (2,) or (n, 2) in m."""
    slots = np.array([(image.site, image.vt) for image in images])
    position, by = place_of(f, slots.ravel())
    position, by = position.reshape(-1, 2, 2), by.reshape(-1, 2, 2, 3)
    value, by_places = mirror_plane(position[:, 0], position[:, 1], about)
    by_states = np.einsum("napc,npci->napi", by_places.reshape(-1, 2, 2, 2), by).reshape(-1, 2, 6)
    return Planes(value, f.vt_state[slots, VT : VT + 3].reshape(-1, 6), by_states)


def difference(planes: Planes) -> Floats:
    """Return by what the first of two planes differs from the second, (2,) in rad and m."""
    apart = planes.value[0] - planes.value[1]
    return np.array([wrap_angle(apart[0]), apart[1]])


def middle(a: Image, b: Image) -> Floats:
    """Return the place (2,) in m in the middle between two visible parts."""
    return np.asarray(0.5 * (a.points.mean(axis=0) + b.points.mean(axis=0)))


def log_odds(f: Filter, a: Image, b: Image, flat: Flatness) -> float:
    """Return the log-odds that two images next to each other are of one wall; -inf beyond the gate."""
    planes = planes_of(f, (a, b), middle(a, b))
    apart, joint = difference(planes), planes.covariance(f)
    s = joint[0, :, 0] + joint[1, :, 1] - joint[0, :, 1] - joint[1, :, 0] + flat.covariance
    distance2 = float(apart @ np.linalg.solve(s, apart))
    if distance2 > GATE:
        return -math.inf
    density = -0.5 * distance2 - 0.5 * math.log(np.linalg.det(s)) - math.log(2.0 * math.pi)
    return density + math.log(4.0 * OTHER_RAD * OTHER_M)


def best_pair(f: Filter, images: list[Image], wall: Ints, flat: Flatness, odds: float) -> tuple[int, int] | None:
    """Return the likeliest two images of one wall that are not known to be so, if there are such; wall (n,): the wall
    of each image; odds: the least log-odds that will do.

    A pair waits while one of its images goes as well with a third one that does not go with the other.
    """
    score = np.full((len(images), len(images)), -math.inf)
    for i, j in combinations(range(len(images)), 2):
        if wall[i] != wall[j] and _next_to_each_other(images[i], images[j], flat.gap):
            score[i, j] = score[j, i] = log_odds(f, images[i], images[j], flat)
    for flatly in np.argsort(-np.triu(score, 1), axis=None, kind="stable"):
        i, j = divmod(int(flatly), len(images))
        if i >= j or score[i, j] < odds:
            break
        for here, there in ((i, j), (j, i)):
            rival = (score[here] > score[i, j] - RIVAL) & (wall != wall[there]) & (score[there] < odds)
            rival[there] = False
            if rival.any():
                break
        else:
            return i, j
    return None


def impose(f: Filter, a: Image, b: Image, flat: Flatness) -> None:
    """Let a filter know that two images are of one wall: an iterated update by a difference of zero."""
    n, before, about = int(f.size[0]), f.x.copy(), middle(a, b)
    for _ in range(ITERATIONS):
        planes = planes_of(f, (a, b), about)
        at, by = planes.at.ravel(), np.concatenate([planes.by[0], -planes.by[1]], axis=1)
        hp = by @ f.p[at, :n]
        root = np.linalg.cholesky(hp[:, at] @ by.T + flat.covariance)
        gains = np.linalg.solve(root, hp)
        left = -difference(planes) - by @ (before[at] - f.x[at])
        f.x[:n] = before[:n] + np.linalg.solve(root, left) @ gains
    f.p[:n, :n] -= gains.T @ gains


def _next_to_each_other(a: Image, b: Image, gap: float) -> bool:
    """Return whether two images' walls look to the same side, and their visible parts are next to each other."""
    if abs(wrap_angle(a.azimuth - b.azimuth)) > TURNED:
        return False
    along = normals(a.azimuth)[1]
    one, other = a.points @ along, b.points @ along
    return bool(one.min() - other.max() <= gap and other.min() - one.max() <= gap)
