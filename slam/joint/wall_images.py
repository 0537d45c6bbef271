"""VTs as what they are: a site, its image in a vertical wall, or the image of an image; which images are in one wall.

Which VT is the site. The site is nearer to the vehicle than any of its images, wherever one of them is seen: a wall
that reflects has vehicle and site on one side. So the VT that is nearest at all places from which others of its link
were seen is the site, also where its line of sight was blocked then.

Which images are in one wall. The planes that mirror two sites to two VTs differ by e: an azimuth, and a distance at a
place between their visible parts. With H its Jacobian by the state, P the covariance and R how flat facades are, the
log-odds of one wall are

    log N(e; 0, S) + log AREA,    S = H P H^T + R        if they are not one, they differ by anything within AREA

What is believed is imposed once, as a measurement of e = 0 with the covariance R (an iterated update): the joint filter
then is one whose landmark is the wall.

Double reflections. A path over two walls comes from the image, in the second wall, of the site's image in the first. So
where both walls are known by images of their own, its VT is known, too, and it is no wall's: the plane half-way from
the site to it is none. Such triples are judged and imposed in the same way. Many fit by chance; few of them have paths
that meet both walls where these were seen.

Sources: Leitinger, Venus, Teague and Meyer, "Data fusion for multipath-based SLAM: combining information from multiple
propagation paths", IEEE Trans. Signal Processing 71, 2023, section III, for walls that several sites share; Simon,
"Kalman filtering with state constraints", IET Control Theory and Applications 4(8), 2010, section 2.3, for constraints
as measurements; Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE Trans. Automatic
Control 38, 1993; Borish, "Extension of the image model to arbitrary polyhedra", J. Acoustical Society of America 75(6),
1984, for images of images and which are valid. Which VT is the site, and the odds of doubles: own derivations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.map_states import confirmed_images
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from cellslam.slam.joint.state.layout import HITS, IDENT, LINK, SURVEYED, VT, Filter
from cellslam.slam.model.walls import image_in_wall, mirror_plane, normals, quarter_turned, reflection_point

SITE_M = 15.0  # a VT this near to its site is the site once more
SLACK_M = 5.0  # by which the site may seem farther than an image: VTs are not known exactly
FEWEST_IMAGES, FEWEST_PLACES = 3, 60  # images and places that tell which VT is the site
MOST_FARTHER = 0.01  # share of the places at which it may be farther all the same

# Walls that are next to each other differ by 90 degrees and 25 m either way, if they differ: uniform, in rad m.
AREA = math.pi * 50.0
RIVAL = 3.0  # log-odds by which a pair must be likelier than another one of either image
GATE = 9.0  # squared Mahalanobis distance of what may be one
ITERATIONS = 3  # of the update that imposes it
TURNED = 0.5  # walls whose directions differ by more than this, in rad, are not compared

NEAR_M = 15.0  # a VT farther than this from an image's image is not compared
AREA_M2 = 50.0**2  # over which VTs near one are, if it is not their place
BY_CHANCE = 0.02  # share of the triples that are of something else whose paths meet both walls all the same
MOST = 0.5  # of the places from which a VT was seen

Places = Mapping[int, Floats]  # from where the VTs were seen, (n, 2) in m, by identity


class Image(NamedTuple):
    """The image of a site in a wall: slots of `vt` and `site` in a filter, identity, azimuth of the wall's normal in
    rad; where paths were reflected, `points` (n, 2) in m."""

    vt: int
    site: int
    ident: int
    azimuth: float
    points: Floats


def position_of(f: Filter, slots: Ints) -> tuple[Floats, Floats]:
    """Return where VTs are, seen from above, (n, 2) in m, and its Jacobians (n, 2, 3) by range, azimuth, elevation."""
    away, azimuth, elevation = f.x[f.vts.state[slots, VT : VT + 3]].T[:, :, None]
    across, along = normals(azimuth[:, 0])
    level, up = np.cos(elevation), np.sin(elevation)
    by = np.stack([level * across, away * level * along, -away * up * across], axis=-1)
    return f.vts.anchor[slots, :2] + away * level * across, by


def ends_of(f: Filter, images: Sequence[Image]) -> tuple[Floats, Floats, Ints]:
    """Return site and VT of each image, seen from above, (n, 2, 2) in m, their Jacobians (n, 2, 2, 3), and the states
    (n, 6) that these are by."""
    slots = np.array([(image.site, image.vt) for image in images], np.int64).reshape(-1, 2)
    place, by = position_of(f, slots.ravel())
    return place.reshape(-1, 2, 2), by.reshape(-1, 2, 2, 3), f.vts.state[slots, VT : VT + 3].reshape(-1, 6)


def images_of(f: Filter, seen: Places, hits: int) -> list[Image]:
    """Return the images among a filter's VTs with so many detections, on links whose site is among them."""
    slots = np.flatnonzero(confirmed_images(f, hits))
    surveyed = f.vts.slots[slots, SURVEYED] == 1  # seen or not
    slots = slots[surveyed | np.isin(f.vts.slots[slots, IDENT], list(seen))]
    found = list[Image]()
    for link in np.unique(f.vts.slots[slots, LINK]):
        mine = slots[f.vts.slots[slots, LINK] == link]
        position = position_of(f, mine)[0]
        places = [seen.get(ident, np.empty((0, 2))) for ident in f.vts.slots[mine, IDENT].tolist()]
        known = np.flatnonzero(f.vts.slots[mine, SURVEYED] == 1)
        site = int(known[0]) if len(known) else _site(position, places, f.vts.slots[mine, HITS])
        if site >= 0:
            away = position - position[site]
            for k in np.flatnonzero(np.hypot(*away.T) > SITE_M):
                points = reflection_point(position[site], position[k], places[k])
                points = points[np.isfinite(points).all(axis=1)]
                if len(points):
                    azimuth = float(np.arctan2(away[k, 1], away[k, 0]))
                    found.append(
                        Image(int(mine[k]), int(mine[site]), int(f.vts.slots[mine[k], IDENT]), azimuth, points)
                    )
    return found


def _site(position: Floats, places: list[Floats], hits: Ints) -> int:
    """Return which of the VTs of a link, at (n, 2) in m and seen from `places`, is the site; -1: it is not known."""
    whose = np.repeat(np.arange(len(places)), [len(p) for p in places])
    apart = np.linalg.norm(np.concatenate(places) - position[:, None], axis=-1)  # VT, place
    farther = apart > apart[whose, np.arange(len(whose))] + SLACK_M
    others = len(whose) - np.bincount(whose, minlength=len(places))
    likely = (len(places) > FEWEST_IMAGES) & (others >= FEWEST_PLACES) & (farther.sum(axis=1) <= MOST_FARTHER * others)
    return int(np.argmax(np.where(likely, hits, -1))) if likely.any() else -1


class Gap(NamedTuple):
    """By what two things differ, `value` (2,), and its Jacobian `by` (2, n) by the states that are `at` (n,)."""

    value: Floats
    at: Ints
    by: Floats


def log_odds(f: Filter, gap: Gap, spread: Floats, area: float) -> float:
    """Return the log-odds that two things are one, of a gap with the variance `spread` (2, 2); -inf beyond the gate.

    area: in the gap's units, over which two things differ, if they are not one.
    """
    s = gap.by @ f.p[np.ix_(gap.at, gap.at)] @ gap.by.T + spread
    distance2 = float(gap.value @ np.linalg.solve(s, gap.value))
    if distance2 > GATE:
        return -math.inf
    return -0.5 * distance2 - 0.5 * math.log(np.linalg.det(s)) - math.log(2.0 * math.pi) + math.log(area)


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
    """Return the root (2, 2) of the gap's covariance, and what it says of the states, whitened by that (2, n)."""
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
            score[i, j] = score[j, i] = log_odds(f, apart(f, images[i], images[j]), flat.covariance, AREA)
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


class Double(NamedTuple):
    """The image `vt` of the image `first` in the wall of the image `second`."""

    vt: Image
    first: Image
    second: Image


def likeliest_double(
    f: Filter, images: Sequence[Image], seen: Places, flat: Flatness, odds: float
) -> Double | None:  # fmt: skip
    """Return the likeliest double reflection among images, if one has the log-odds `odds` against being anything."""
    best, answer = odds, None
    for site in {image.site for image in images}:
        mine = [image for image in images if image.site == site]
        for double in _near(f, site, mine):
            places = seen[double.vt.ident]
            likely = log_odds(f, off(f, double), _spread(f, double, places, flat), AREA_M2) - math.log(BY_CHANCE)
            if likely > best and _meets_both(f, double, places, flat.gap):
                best, answer = likely, double
    return answer


def impose_double(f: Filter, double: Double, seen: Places, flat: Flatness) -> None:
    """Let a filter know that a VT is a double reflection's."""
    impose(f, lambda now: off(now, double), _spread(f, double, seen[double.vt.ident], flat))


def off(f: Filter, double: Double) -> Gap:
    """Return by what the image's image is off its VT, in m."""
    slots = np.array([double.vt.site, double.second.vt, double.first.vt, double.vt.vt])
    (site, second, first, vt), by = position_of(f, slots)
    image, by_ends = image_in_wall(site, second, first)
    by_places = np.concatenate([by_ends, -np.eye(2)], axis=1).reshape(2, 4, 2)
    by_states = np.einsum("apc,pci->api", by_places, by).reshape(2, 12)
    return Gap(image - vt, f.vts.state[slots, VT : VT + 3].ravel(), by_states)


def _near(f: Filter, site: int, images: Sequence[Image]) -> list[Double]:
    """Return the triples of a site's images of which one is near the image of another in the wall of the third."""
    places = position_of(f, np.array([*(image.vt for image in images), site]))[0]
    p, v = places[-1], places[:-1]
    across = (v - p) / np.linalg.norm(v - p, axis=1, keepdims=True)
    behind = ((v - 0.5 * (p + v[:, None])) * across[:, None]).sum(axis=-1)  # second, first
    mirrored = v - 2.0 * behind[..., None] * across[:, None]
    near = np.linalg.norm(mirrored[:, :, None] - v, axis=-1) <= NEAR_M  # second, first, VT
    same = np.eye(len(v), dtype=bool)
    near &= ~(same[:, :, None] | same[:, None] | same)
    return [Double(images[c], images[a], images[b]) for b, a, c in np.argwhere(near).tolist()]


def _spread(f: Filter, double: Double, places: Floats, flat: Flatness) -> Floats:
    """Return the covariance (2, 2) in m^2 of what parts of two walls may be turned and set off: an image moves by twice
    of that."""
    offset = position_of(f, np.array([double.vt.vt]))[0][0] - places.mean(axis=0)
    across = quarter_turned(offset)
    return np.asarray(8.0 * (flat.off**2 * np.eye(2) + flat.turned**2 * np.outer(across, across)))


def _meets_both(f: Filter, double: Double, places: Floats, gap: float) -> bool:
    """Return whether paths from the VT meet both walls within their visible parts, and are longer than those over the
    first wall alone, from most of the places from which it was seen."""
    site, first, vt = position_of(f, np.array([double.vt.site, double.first.vt, double.vt.vt]))[0]
    later = reflection_point(first, vt, places)
    earlier = reflection_point(site, first, later)
    meets = np.linalg.norm(places - vt, axis=1) > np.linalg.norm(places - first, axis=1)
    for image, points in ((double.first, earlier), (double.second, later)):
        along = normals(image.azimuth)[1]
        at, part = points @ along, image.points @ along
        meets &= (at >= part.min() - gap) & (at <= part.max() + gap)  # not so where there is no point: NaN
    return bool(meets.mean() >= MOST)
