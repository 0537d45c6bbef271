"""Which images are in one wall, how likely that is, and what it teaches a joint filter.

The planes that mirror two sites to two VTs differ by e: an azimuth, and a distance at a place between their visible
parts. With H its Jacobian by the state, P the covariance and R how flat facades are, the log-odds of one wall are

    log N(e; 0, S) + log ROOM,    S = H P H^T + R        if they are not one, they differ by anything within ROOM

What is believed is imposed once, as a measurement of e = 0 with the covariance R (an iterated update): the joint filter
then is one whose landmark is the wall. Images of images (`doubles`) are judged and imposed in the same way.

Sources: Leitinger, Venus, Teague and Meyer, "Data fusion for multipath-based SLAM: combining information from multiple
propagation paths", IEEE Trans. Signal Processing 71, 2023, for walls that several sites share; Simon, "Kalman filtering
with state constraints", IET Control Theory and Applications 4(8), 2010, section 2.3, for constraints as measurements;
Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE Trans. Automatic Control 38, 1993.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from cellslam.slam.joint.state.layout import Filter
from cellslam.slam.joint.walls.images import Image, ends_of
from cellslam.slam.model.walls import mirror_plane, normals

# Walls that are next to each other differ by 90 degrees and 25 m either way, if they differ: uniform, in rad m.
ROOM = math.pi * 50.0
RIVAL = 3.0  # log-odds by which a pair must be likelier than another one of either image
GATE = 9.0  # squared Mahalanobis distance of what may be one
ITERATIONS = 3  # of the update that imposes it
TURNED = 0.5  # walls whose directions differ by more than this, in rad, are not looked at


class Gap(NamedTuple):
    """By what two things differ, `value` (2,), and its Jacobian `by` (2, n) by the states that are `at` (n,)."""

    value: Floats
    at: Ints
    by: Floats


def log_odds(f: Filter, gap: Gap, spread: Floats, room: float) -> float:
    """Return the log-odds that two things are one, of a gap with the variance `spread` (2, 2); -inf beyond the gate.

    room: area, in the gap's units, over which two things differ, if they are not one.
    """
    s = gap.by @ f.p[np.ix_(gap.at, gap.at)] @ gap.by.T + spread
    distance2 = float(gap.value @ np.linalg.solve(s, gap.value))
    if distance2 > GATE:
        return -math.inf
    return -0.5 * distance2 - 0.5 * math.log(np.linalg.det(s)) - math.log(2.0 * math.pi) + math.log(room)


def impose(f: Filter, measure: Callable[[Filter], Gap], spread: Floats) -> None:
    """Let a filter know that two things are one: an iterated update by a gap of zero, with the variance `spread`."""
    n, before = int(f.size[0]), f.x.copy()
    for _ in range(ITERATIONS):
        gap = measure(f)
        root, gains = _gains(f, gap, spread)
        left = -gap.value - gap.by @ (before[gap.at] - f.x[gap.at])
        f.x[:n] = before[:n] + np.linalg.solve(root, left) @ gains
    carry_over(f, before, np.empty((4, len(before))))
    _, gains = _gains(f, measure(f), spread)
    f.p[:n, :n] -= gains.T @ gains


def _gains(f: Filter, gap: Gap, spread: Floats) -> tuple[Any, Any]:
    """Return the root (2, 2) of the gap's covariance, and what it says of the states, whitened by that (2, N)."""
    hp = gap.by @ f.p[gap.at, : f.size[0]]
    root = np.linalg.cholesky(hp[:, gap.at] @ gap.by.T + spread)
    return root, np.linalg.solve(root, hp)


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
        count, at = len(self.at), self.at.ravel()
        half = self.by @ f.p[at[:, None], at].reshape(count, 6, 6 * count)  # n, a, (m, j)
        return np.asarray(np.einsum("mbj,namj->namb", self.by, half.reshape(count, 2, count, 6)))


def planes_of(f: Filter, images: Sequence[Image], about: Floats) -> Planes:
    """Return the planes of images as seen from `about` (2,) or (n, 2) in m."""
    position, by, at = ends_of(f, images)
    value, by_places = mirror_plane(position[:, 0], position[:, 1], about)
    by_states = np.einsum("napc,npci->napi", by_places.reshape(-1, 2, 2, 2), by).reshape(-1, 2, 6)
    return Planes(value, at, by_states)


def apart(f: Filter, a: Image, b: Image) -> Gap:
    """Return by what the planes of two images differ in the middle between their visible parts, in rad and m."""
    planes = planes_of(f, (a, b), 0.5 * (a.points.mean(axis=0) + b.points.mean(axis=0)))
    azimuth, distance = planes.value[0] - planes.value[1]
    by = np.concatenate([planes.by[0], -planes.by[1]], axis=1)
    return Gap(np.array([wrap_angle(azimuth), distance]), planes.at.ravel(), by)


def best_pair(f: Filter, images: list[Image], wall: Ints, flat: Flatness, odds: float) -> tuple[int, int] | None:
    """Return the likeliest two images of one wall that are not known to be so, if there are such; wall (n,): the wall
    of each image; odds: the least log-odds that will do.

    A pair waits while one of its images goes as well with a third one that does not go with the other.
    """
    score = np.full((len(images), len(images)), -math.inf)
    for i, j in combinations(range(len(images)), 2):
        if wall[i] != wall[j] and _next_to_each_other(images[i], images[j], flat.gap):
            score[i, j] = score[j, i] = log_odds(f, apart(f, images[i], images[j]), flat.covariance, ROOM)
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


def _next_to_each_other(a: Image, b: Image, gap: float) -> bool:
    """Return whether two images' walls look to the same side, and their visible parts are next to each other."""
    if abs(wrap_angle(a.azimuth - b.azimuth)) > TURNED:
        return False
    along = normals(a.azimuth)[1]
    one, other = a.points @ along, b.points @ along
    return bool(one.min() - other.max() <= gap and other.min() - one.max() <= gap)
