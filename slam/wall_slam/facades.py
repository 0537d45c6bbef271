"""The walls of a drive: from where images were seen, which are in one wall or in two, and the map that follows."""

from __future__ import annotations

from functools import partial

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import WallEstimate
from cellslam.slam.ekf_slam.state.layout import Filter
from cellslam.slam.model.walls import normals, reflection_point
from cellslam.slam.wall_slam.constraints import impose
from cellslam.slam.wall_slam.doubles import impose_double, likeliest_double
from cellslam.slam.wall_slam.images import Image, images_of, place_of
from cellslam.slam.wall_slam.joining import Flatness, apart, best_pair, planes_of

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
        images, here = self._images(f, LEAST_HITS), f.x[:2]
        wall, missed = self._walls(images), list[int]()
        for image, mine in zip(images, wall, strict=True):
            site, vt = place_of(f, np.array([image.site, image.vt]))[0]
            along = normals(image.azimuth)[1]
            part = np.concatenate([other.points for other, k in zip(images, wall, strict=True) if k == mine]) @ along
            at = reflection_point(site, vt, here) @ along
            if not part.min() - self._flat.gap <= at <= part.max() + self._flat.gap:
                missed.append(image.ident)
        return missed

    def estimate(self, f: Filter, hits: int) -> WallEstimate:
        """Return the walls that a filter's VTs with so many detections are images in."""
        images = self._images(f, hits)
        walls, which = np.unique(self._walls(images), return_inverse=True)
        planes = [
            _plane(f, [image for image, k in zip(images, which, strict=True) if k == n]) for n in range(len(walls))
        ]
        mean, covariance, extent = (np.array([plane[c] for plane in planes]) for c in range(3))
        azimuth, distance = mean.reshape(-1, 2).T.copy()
        return WallEstimate(walls, azimuth, distance, covariance.reshape(-1, 2, 2), extent.reshape(-1, 2))

    def _images(self, f: Filter, hits: int) -> list[Image]:
        return [image for image in images_of(f, self._seen, hits) if image.ident not in self._doubles]

    def _walls(self, images: list[Image]) -> Ints:
        return np.array([self._wall.get(image.ident, image.ident) for image in images], np.int64)


def _plane(f: Filter, images: list[Image]) -> tuple[Floats, Floats, Floats]:
    """Return azimuth and distance from the origin (2,) of a wall, their covariance (2, 2), and its extent (2,).

    The mean of what each image shows, weighted by their joint covariance (Gauss-Markov).
    """
    points = np.concatenate([image.points for image in images])
    about = 0.5 * (points.min(axis=0) + points.max(axis=0))
    planes = planes_of(f, images, about)
    # Images of one wall differ by next to nothing: what is singular to rounding is no information.
    weight = np.linalg.pinv(planes.covariance(f).reshape(2 * len(images), -1), rcond=1e-9, hermitian=True)
    each = np.tile(np.eye(2), (len(images), 1))
    covariance = np.linalg.inv(each.T @ weight @ each)
    off = planes.value - planes.value[0]
    off[:, 0] = wrap_angle(off[:, 0])
    azimuth, distance = planes.value[0] + covariance @ each.T @ weight @ off.ravel()
    across, along = normals(azimuth)
    shift = np.array([[1.0, 0.0], [about @ along, 1.0]])
    covariance = shift @ covariance @ shift.T
    t = points @ along
    return (
        np.array([wrap_angle(azimuth), distance + about @ across]),
        0.5 * (covariance + covariance.T),
        np.array([t.min(), t.max()]),
    )
