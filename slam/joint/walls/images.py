"""VTs as what they are: a site, or its image in a vertical wall.

The site is nearer to the vehicle than any of its images, wherever one of them is seen: a wall that reflects has vehicle
and site on one side. So the VT that is nearest at all places from which others of its link were seen is the site, also
where its line of sight was blocked then.

Source: Leitinger, Venus, Teague and Meyer, "Data fusion for multipath-based SLAM: combining information from multiple
propagation paths", IEEE Trans. Signal Processing 71, 2023, section III; which VT is the site: own derivation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.state.layout import HITS, IDENT, LINK, SHARE, VT, Filter
from cellslam.slam.model.walls import normals, reflection_point

SITE_M = 15.0  # a VT this near to its site is the site once more
SLACK_M = 5.0  # by which the site may seem farther than an image: VTs are not known exactly
FEWEST_IMAGES, FEWEST_PLACES = 3, 60  # images and places that tell which VT is the site
MOST_FARTHER = 0.01  # share of the places at which it may be farther all the same

Places = Mapping[int, Floats]  # from where the VTs were seen, (n, 2) in m, by identity


class Image(NamedTuple):
    """The image of a site in a wall: slots of `vt` and `site` in a filter, identity, azimuth of the wall's normal in
    rad; where paths were reflected, `points` (n, 2) in m."""

    vt: int
    site: int
    ident: int
    azimuth: float
    points: Floats


def place_of(f: Filter, slots: Ints) -> tuple[Floats, Floats]:
    """Return where VTs are, seen from above, (n, 2) in m, and its Jacobians (n, 2, 3) by range, azimuth, elevation."""
    away, azimuth, elevation = f.x[f.vt_state[slots, VT : VT + 3]].T[:, :, None]
    across, along = normals(azimuth[:, 0])
    level, up = np.cos(elevation), np.sin(elevation)
    by = np.stack([level * across, away * level * along, -away * up * across], axis=-1)
    return f.anchor[slots, :2] + away * level * across, by


def ends_of(f: Filter, images: Sequence[Image]) -> tuple[Floats, Floats, Ints]:
    """Return site and VT of each image, seen from above, (n, 2, 2) in m, their Jacobians (n, 2, 2, 3), and the states
    (n, 6) that these are by."""
    slots = np.array([(image.site, image.vt) for image in images], np.int64).reshape(-1, 2)
    place, by = place_of(f, slots.ravel())
    return place.reshape(-1, 2, 2), by.reshape(-1, 2, 2, 3), f.vt_state[slots, VT : VT + 3].reshape(-1, 6)


def images_of(f: Filter, seen: Places, hits: int) -> list[Image]:
    """Return the images among a filter's VTs with so many detections, on links whose site is among them."""
    slots = np.flatnonzero((f.slots[: f.count[0], HITS] >= hits) & (f.anchor[: f.count[0], SHARE] > 0.5))
    exact = f.p[f.vt_state[slots, VT], f.vt_state[slots, VT]] == 0.0  # sites that were surveyed, seen or not
    slots = slots[exact | np.isin(f.slots[slots, IDENT], list(seen))]
    found = list[Image]()
    for link in np.unique(f.slots[slots, LINK]):
        mine = slots[f.slots[slots, LINK] == link]
        position = place_of(f, mine)[0]
        places = [seen.get(ident, np.empty((0, 2))) for ident in f.slots[mine, IDENT].tolist()]
        known = np.flatnonzero(f.p[f.vt_state[mine, VT], f.vt_state[mine, VT]] == 0.0)
        site = int(known[0]) if len(known) else _site(position, places, f.slots[mine, HITS])
        if site >= 0:
            away = position - position[site]
            for k in np.flatnonzero(np.hypot(*away.T) > SITE_M):
                points = reflection_point(position[site], position[k], places[k])
                points = points[np.isfinite(points).all(axis=1)]
                if len(points):
                    azimuth = float(np.arctan2(away[k, 1], away[k, 0]))
                    found.append(Image(int(mine[k]), int(mine[site]), int(f.slots[mine[k], IDENT]), azimuth, points))
    return found


def _site(position: Floats, places: list[Floats], hits: Ints) -> int:
    """Return which of the VTs of a link, at (n, 2) in m and seen from `places`, is the site; -1: it is not known."""
    whose = np.repeat(np.arange(len(places)), [len(p) for p in places])
    apart = np.linalg.norm(np.concatenate(places) - position[:, None], axis=-1)  # VT, place
    farther = apart > apart[whose, np.arange(len(whose))] + SLACK_M
    others = len(whose) - np.bincount(whose, minlength=len(places))
    likely = (len(places) > FEWEST_IMAGES) & (others >= FEWEST_PLACES) & (farther.sum(axis=1) <= MOST_FARTHER * others)
    return int(np.argmax(np.where(likely, hits, -1))) if likely.any() else -1
