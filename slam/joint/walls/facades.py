"""The walls of a drive: from where images were seen, which are in one wall or in two, and the map that follows."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import WallEstimate
from cellslam.slam.joint.state.layout import Filter
from cellslam.slam.joint.walls.doubles import impose_double, likeliest_double
from cellslam.slam.joint.walls.images import Image, ends_of, images_of
from cellslam.slam.joint.walls.joining import Flatness, apart, best_pair, impose, planes_of
from cellslam.slam.model.walls import normals, reflection_point

STEP_M = 1.0  # between places from which a VT was seen
LEAST_HITS = 20  # detections of an image that may be joined with others


class Facades:
    """What is known of walls; they are named by the identities of their first images."""

    def __init__(self, flat: Flatness, log_odds: float) -> None:
        """Take how flat facades are, and from which log-odds on two images are of one wall."""
        self._flat, self._log_odds = flat, log_odds
        self._seen: dict[int, Floats] = {}
        self._wall: dict[int, int] = {}
        self._doubles = set[int]()

    def see(self, ident: int, place: Floats) -> None:
        """Note that a VT is seen from a place (2,) in m."""
        places = self._seen.get(ident)
        if places is None:
            self._seen[ident] = place[None].copy()
        elif np.hypot(*(places[-1] - place)) >= STEP_M:
            self._seen[ident] = np.concatenate([places, place[None]])

    def join(self, f: Filter) -> None:
        """Let a filter know which images are of two walls, and which are of one, as far as that has become sure."""
        images = self._images(f, LEAST_HITS)
        while (double := likeliest_double(f, images, self._seen, self._flat, self._log_odds)) is not None:
            impose_double(f, double, self._seen, self._flat)
            self._doubles.add(double.vt.ident)
            images = self._images(f, LEAST_HITS)
        while (pair := best_pair(f, images, self._walls(images), self._flat, self._log_odds)) is not None:
            one, other = (images[i] for i in pair)
            impose(f, partial(apart, a=one, b=other), self._flat.covariance)
            old, new = (self._wall.get(image.ident, image.ident) for image in (other, one))
            self._wall |= {ident: new for ident, wall in self._wall.items() if wall == old}
            self._wall |= {old: new, other.ident: new, one.ident: new}

    def not_met(self, f: Filter) -> list[int]:
        """Return the identities of images whose walls, as far as they were seen, paths to the vehicle would miss."""
        images = self._images(f, LEAST_HITS)
        wall = self._walls(images)
        points = {k: _points(images, wall == k) for k in np.unique(wall).tolist()}
        site, vt = np.swapaxes(ends_of(f, images)[0], 0, 1)
        meets, missed = reflection_point(site, vt, f.x[:2]), list[int]()
        for image, k, point in zip(images, wall.tolist(), meets, strict=True):
            along = normals(image.azimuth)[1]
            part, at = points[k] @ along, point @ along
            if not part.min() - self._flat.gap <= at <= part.max() + self._flat.gap:
                missed.append(image.ident)
        return missed

    def estimate(self, f: Filter, hits: int) -> WallEstimate:
        """Return the walls that a filter's VTs with so many detections are images in."""
        images = self._images(f, hits)
        walls, which = np.unique(self._walls(images), return_inverse=True)
        parts = [which == n for n in range(len(walls))]
        points = [_points(images, mine) for mine in parts]
        middle = np.array([0.5 * (p.min(axis=0) + p.max(axis=0)) for p in points]).reshape(-1, 2)
        planes = planes_of(f, images, middle[which])
        joint = planes.covariance(f)
        found = [_mean(planes.value[mine], joint[mine][:, :, mine]) for mine in parts]
        mean, covariance = (np.array([each[c] for each in found]) for c in range(2))
        azimuth, distance = mean.reshape(-1, 2).T
        across, along = normals(azimuth)
        reach = [p @ ahead for p, ahead in zip(points, along, strict=True)]
        extent = np.array([(t.min(), t.max()) for t in reach]).reshape(-1, 2)
        shift = np.tile(np.eye(2), (len(walls), 1, 1))  # from the middle to the origin
        shift[:, 1, 0] = (middle * along).sum(axis=1)
        covariance = shift @ covariance.reshape(-1, 2, 2) @ np.swapaxes(shift, 1, 2)
        return WallEstimate(
            walls, np.asarray(wrap_angle(azimuth)), distance + (middle * across).sum(axis=1),
            0.5 * (covariance + np.swapaxes(covariance, 1, 2)), extent,
        )  # fmt: skip

    def _images(self, f: Filter, hits: int) -> list[Image]:
        return [image for image in images_of(f, self._seen, hits) if image.ident not in self._doubles]

    def _walls(self, images: list[Image]) -> Ints:
        return np.array([self._wall.get(image.ident, image.ident) for image in images], np.int64)


def _points(images: list[Image], which: NDArray[np.bool_]) -> Floats:
    """Return where the paths of some images (n,) were reflected, (p, 2) in m."""
    return np.concatenate([image.points for image, mine in zip(images, which.tolist(), strict=True) if mine])


def _mean(planes: Floats, joint: Floats) -> tuple[Floats, Floats]:
    """Return the mean (2,) of planes (n, 2), weighted by their joint covariance (n, 2, n, 2), and its own (2, 2).

    That is their Gauss-Markov estimate.
    """
    count = len(planes)
    if count == 1:
        return planes[0], joint[0, :, 0]
    # Images of one wall differ by next to nothing: what is singular to rounding is no information.
    weight = np.linalg.pinv(joint.reshape(2 * count, -1), rcond=1e-9, hermitian=True)
    each = np.tile(np.eye(2), (count, 1))
    covariance = np.linalg.inv(each.T @ weight @ each)
    off = planes - planes[0]
    off[:, 0] = wrap_angle(off[:, 0])
    return np.asarray(planes[0] + covariance @ each.T @ weight @ off.ravel()), np.asarray(covariance)
