"""WALL-SLAM: EKF-SLAM that knows that VTs of several sites may be images in one wall, and that maps the walls.

State, prediction, update and weight are those of EKF-SLAM (ekf_slam.py). Between blocks:
    sites       of a link's VTs the one that is nearest from where the others were seen    wall_images.py: images_of
    walls       the plane that mirrors site p to image v: azimuth of v - p, distance of (v + p) / 2 along it
                                                                                           wall_images.py: planes_of
    one wall?   e = difference of two planes, S = H P H^T + R: log N(e; 0, S) + log AREA >= log join_odds
                                                                                           best_pair
    if so       a measurement e = 0 with covariance R updates the state, once                 impose
    two walls?  e = image of an image in a second wall - v, judged and imposed alike          wall_images.py
    report      a wall is the Gauss-Markov mean of the planes of its images                   Facades.estimate
    association none with VTs whose walls, as far as they were seen, the path would miss      not_met
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, WallEstimate
from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.start import Start
from cellslam.slam.joint.state.layout import BEYOND, IDENT, LAST, Filter, Measured
from cellslam.slam.joint.wall_images import (
    Flatness,
    Image,
    apart,
    best_pair,
    ends_of,
    images_of,
    impose,
    impose_double,
    likeliest_double,
    planes_of,
)
from cellslam.slam.model.walls import normals, reflection_point

JOINED_EVERY, SHOWN_EVERY, LOOKED_EVERY = 64, 16, 16  # snapshots
NO_WALLS = WallEstimate(
    np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2))
)  # fmt: skip
STEP_M = 1.0  # between places from which a VT was seen
LEAST_HITS = 20  # detections of an image that may be joined with others


class WallSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.wall-slam`."""

    join_odds: float = Field(
        150.0, ge=1, le=1e9, description="odds from which on two VTs are taken for images in one wall; 1e9: never"
    )
    facade_turned_deg: float = Field(0.5, gt=0, le=10, description="by how much parts of one wall are turned, deg")
    facade_off_m: float = Field(0.3, gt=0, le=10, description="by how much parts of one wall are set off, m")
    facade_gap_m: float = Field(10.0, ge=0, le=1000, description="longest gap between parts of one wall, m")


class WallSlam(JointFilter):
    """The joint filter of EKF-SLAM; that two VTs are images in one wall is a measurement, once it is sure."""

    name: ClassVar[str] = "wall-slam"
    Options: ClassVar[type[WallSlamOptions]] = WallSlamOptions

    def __init__(self, options: WallSlamOptions | None = None) -> None:
        self.options: WallSlamOptions = options or WallSlamOptions()

    def _join(self, offsets_m: Floats) -> None:
        o = self.options
        flat = Flatness(math.radians(o.facade_turned_deg), o.facade_off_m, o.facade_gap_m)
        self._facades, self._joined, self._shown, self._looked = Facades(flat, math.log(o.join_odds)), 0, 0, 0
        super()._join(offsets_m)

    def _see(self, association: Ints, place: Floats) -> None:
        super()._see(association, place)
        for ident in association[association >= 0].tolist():
            self._facades.see(ident, place)

    def _use(self, interval: Interval, measured: Measured) -> Ints:
        if measured.now >= self._looked + LOOKED_EVERY:
            self._end_walls(measured)
        association = super()._use(interval, measured)
        mixture = self._joint
        # Between blocks, when no measurements wait for the state that they were held against; of a mixture none is
        # changed.
        between = mixture is not None and len(mixture) == 1 and not mixture.blocks.track.snapshots[0, 0]
        if mixture is not None and between and measured.now >= self._joined + JOINED_EVERY:
            self._facades.join(mixture.likeliest)
            self._joined = measured.now
        return association

    def _end_walls(self, measured: Measured) -> None:
        """Let nothing be associated with VTs, unseen for a while, whose walls would not be met as far as they reach."""
        self._looked, mixture = measured.now, self._joint
        if mixture is not None:
            missed, slots = self._facades.not_met(mixture.likeliest), mixture.arrays.vts.slots
            long_ago = measured.now - slots[..., LAST] > measured.rules.association.away
            slots[..., BEYOND] = np.isin(slots[..., IDENT], missed) & long_ago

    def _step_start(self, start: Start, interval: Interval, measured: Measured) -> Estimate:
        return replace(super()._step_start(start, interval, measured), walls=NO_WALLS)

    def _step_joint(self, interval: Interval, measured: Measured) -> Estimate:
        answer, mixture = super()._step_joint(interval, measured), self._joint
        if mixture is None or measured.now < self._shown + SHOWN_EVERY:
            return answer
        self._shown = measured.now
        return replace(answer, walls=self._facades.estimate(mixture.likeliest, self.options.confirm_hits))


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
