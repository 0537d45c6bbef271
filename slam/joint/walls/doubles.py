"""VTs of double reflections: images in one wall of a site's image in another.

A path over two walls comes from the image, in the second wall, of the site's image in the first. So where both walls
are known by images of their own, its VT is known, too, and it is no wall's: the plane half-way from the site to it is
none. Many triples of VTs fit by chance; few of them have paths that meet both walls where these were seen.

Source: Borish, "Extension of the image model to arbitrary polyhedra", J. Acoustical Society of America 75(6), 1984,
for images of images and which are valid; the odds are an own derivation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.joint.state.layout import VT, Filter
from cellslam.slam.joint.walls.images import Image, Places, place_of
from cellslam.slam.joint.walls.joining import Flatness, Gap, impose, log_odds
from cellslam.slam.model.walls import image_in_wall, normals, quarter_turned, reflection_point

NEAR_M = 15.0  # a VT farther than this from an image's image is not looked at
ROOM_M2 = 50.0**2  # over which VTs near one are, if it is not their place
BY_CHANCE = 0.02  # share of the triples that are of something else whose paths meet both walls all the same
MOST = 0.5  # of the places from which a VT was seen


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
            likely = log_odds(f, off(f, double), _spread(f, double, places, flat), ROOM_M2) - math.log(BY_CHANCE)
            if likely > best and _meets_both(f, double, places, flat.gap):
                best, answer = likely, double
    return answer


def impose_double(f: Filter, double: Double, seen: Places, flat: Flatness) -> None:
    """Let a filter know that a VT is a double reflection's."""
    impose(f, lambda now: off(now, double), _spread(f, double, seen[double.vt.ident], flat))


def off(f: Filter, double: Double) -> Gap:
    """Return by what the image's image is off its VT, in m."""
    slots = np.array([double.vt.site, double.second.vt, double.first.vt, double.vt.vt])
    (site, second, first, vt), by = place_of(f, slots)
    image, by_ends = image_in_wall(site, second, first)
    by_places = np.concatenate([by_ends, -np.eye(2)], axis=1).reshape(2, 4, 2)
    by_states = np.einsum("apc,pci->api", by_places, by).reshape(2, 12)
    return Gap(image - vt, f.vt_state[slots, VT : VT + 3].ravel(), by_states)


def _near(f: Filter, site: int, images: Sequence[Image]) -> list[Double]:
    """Return the triples of a site's images of which one is near the image of another in the wall of the third."""
    places = place_of(f, np.array([*(image.vt for image in images), site]))[0]
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
    offset = place_of(f, np.array([double.vt.vt]))[0][0] - places.mean(axis=0)
    across = quarter_turned(offset)
    return np.asarray(8.0 * (flat.off**2 * np.eye(2) + flat.turned**2 * np.outer(across, across)))


def _meets_both(f: Filter, double: Double, places: Floats, gap: float) -> bool:
    """Return whether paths from the VT meet both walls within their visible parts, and are longer than those over the
    first wall alone, from most of the places from which it was seen."""
    site, first, vt = place_of(f, np.array([double.vt.site, double.first.vt, double.vt.vt]))[0]
    later = reflection_point(first, vt, places)
    earlier = reflection_point(site, first, later)
    meets = np.linalg.norm(places - vt, axis=1) > np.linalg.norm(places - first, axis=1)
    for image, points in ((double.first, earlier), (double.second, later)):
        along = normals(image.azimuth)[1]
        at, part = points @ along, image.points @ along
        meets &= (at >= part.min() - gap) & (at <= part.max() + gap)  # not so where there is no point: NaN
    return bool(meets.mean() >= MOST)
