"""WALL-SLAM: which VT is the site, which images are of one wall, and that the joint filter stays consistent."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest

from cellslam.sim.frames import unit_vector, wrap_angle
from cellslam.slam.joint import wall_images
from cellslam.slam.joint.state.layout import EXISTS, HITS, IDENT, LINK, SURVEYED, UNSEEN, WEIGHT
from cellslam.slam.joint.wall_images import Double, Flatness, apart, best_pair, images_of, impose, position_of
from cellslam.slam.joint.wall_slam import Facades
from cellslam.slam.model.measurement_model import jacobians, predict

FLAT = Flatness(math.radians(0.3), 0.2, 10.0)
SITES = np.array([[-60.0, -30.0, 30.0], [90.0, -50.0, 25.0]])
NORTH, WALL_M = np.pi / 2, 40.0  # a wall at y = 40 m
WAY = np.column_stack([np.linspace(-30.0, 60.0, 91), np.zeros(91)])


def mirrored(site, azimuth=NORTH, distance=WALL_M):
    normal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return site + 2 * (distance - site @ normal) * normal


def filter_of(one_filter, vts, std, rng=None):
    """A filter with VTs (link, position), wrong by errors of their joint covariance if `rng` is given; their states."""
    one = one_filter()
    spherical = [predict(np.zeros(6), np.asarray(at, float)) for _, at in vts]
    one.put(np.zeros(6), 0.0, *spherical)
    f, first, n = one.f, one.mixture.core.size, 3 * len(vts)
    for j, (link, _) in enumerate(vts):
        f.vts.slots[j, [LINK, HITS, IDENT, UNSEEN]] = link, 50, 10 + j, 0
        f.vts.anchor[j, [EXISTS, WEIGHT]] = 1.0
    f.count[0] = len(vts)
    # Errors that all VTs share, beside those of their own: as those of a pose in common.
    scale = std * np.concatenate([[1.0, 1.0 / s[0], 1.0 / s[0]] for s in spherical])
    common = np.tile([0.5, 0.5, 0.0], len(vts))
    f.p[:] = 0.0
    f.p[first : first + n, first : first + n] = np.outer(scale, scale) * (np.eye(n) + np.outer(common, common))
    if rng is not None:
        f.x[first : first + n] += np.linalg.cholesky(f.p[first : first + n, first : first + n]) @ rng.normal(size=n)
    return f, slice(first, first + n)


def seen(f, way=WAY):
    return {int(ident): way for ident in f.vts.slots[: f.count[0], IDENT]}


def scene(azimuth=NORTH, distance=WALL_M):
    """VTs of two sites: the sites, their images in one wall, that of the second as given, and two more of each."""
    others = ((0.0, 150.0), (np.pi, 120.0))
    images = (mirrored(SITES[0]), mirrored(SITES[1], azimuth, distance))
    return [
        (link, at)
        for link in (0, 1)
        for at in (SITES[link], images[link], *(mirrored(SITES[link], *other) for other in others))
    ]


def pair(f):
    """The images in the wall to the north."""
    return [image for image in images_of(f, seen(f), 3) if abs(image.azimuth - NORTH) < 0.3]


def facades_of(f):
    """What is known of walls when all of the way has been driven."""
    facades = Facades(FLAT, 3.0)
    for ident, places in seen(f).items():
        for place in places:
            facades.see(ident, place)
    return facades


def one_wall(f):
    """Log-odds that the images in the wall to the north are of one wall."""
    return wall_images.log_odds(f, apart(f, *pair(f)), FLAT.covariance, wall_images.AREA)


def test_the_site_is_the_vt_that_is_nearest_wherever_others_are_seen(one_filter):
    f, _ = filter_of(one_filter, scene()[:4], 0.1)
    f.vts.slots[:4, HITS] = 30, 500, 400, 300  # others are seen more often
    images = images_of(f, seen(f), 3)
    assert {image.site for image in images} == {0} and sorted(image.vt for image in images) == [1, 2, 3]
    assert images[0].azimuth == pytest.approx(NORTH)
    # From (-60, -30) over y = 40 to (0, 0): two sides of 70 and 40 m.
    np.testing.assert_allclose(images[0].points[30], [-60.0 + 60.0 * 70 / 110, WALL_M])
    assert images_of(f, seen(f, WAY[:15]), 3) == []  # too few places to tell


def test_a_site_that_was_surveyed_need_not_be_seen(one_filter):
    f, _ = filter_of(one_filter, scene()[:2], 0.1)
    f.vts.slots[0, SURVEYED] = 1
    places = seen(f)
    del places[10]
    assert [(image.site, image.vt) for image in images_of(f, places, 3)] == [(0, 1)]


def test_what_is_one_wall(one_filter):
    f, _ = filter_of(one_filter, scene(), 0.5)
    assert one_wall(f) > 5.0
    f.p[:] *= 50.0**2
    assert one_wall(f) < 2.0  # so little is known that it could be any other wall


def test_errors_that_two_images_have_in_common_do_not_set_them_apart(one_filter):
    f, at = filter_of(one_filter, scene(), 0.5)
    far = one_wall(f)
    # All sites and images may be shifted to the north, together.
    shift = np.concatenate([np.linalg.pinv(position_of(f, np.array([j]))[1][0]) @ [0.0, 30.0] for j in range(8)])
    f.p[at, at] += np.outer(shift, shift)
    assert one_wall(f) == pytest.approx(far, abs=1e-6)


@pytest.mark.parametrize(("azimuth", "distance"), [(NORTH, WALL_M + 6.0), (NORTH + 0.15, WALL_M + 2.0)])
def test_what_is_not(one_filter, azimuth, distance):
    f, _ = filter_of(one_filter, scene(azimuth, distance), 0.5)
    assert one_wall(f) == -math.inf


def test_walls_far_apart_or_back_to_back_are_not_one(one_filter):
    f, _ = filter_of(one_filter, scene(), 0.5)
    one, (a, b) = np.arange(2), pair(f)
    assert best_pair(f, [a, b], one, FLAT, 3.0) == (0, 1)
    assert best_pair(f, [a, b], np.zeros(2, int), FLAT, 3.0) is None  # known already
    away = np.array([200.0, 0.0])
    assert best_pair(f, [a, b._replace(points=b.points + away)], one, FLAT, 3.0) is None
    assert best_pair(f, [a, b._replace(azimuth=-NORTH)], one, FLAT, 3.0) is None


def test_a_pair_waits_while_another_one_is_as_likely(one_filter):
    f, _ = filter_of(one_filter, [*scene(NORTH, WALL_M + 0.45), (1, mirrored(SITES[1], NORTH, WALL_M - 0.45))], 0.1)
    images = pair(f)
    assert best_pair(f, images, np.arange(3), FLAT, 3.0) is None
    for others in ([0, 1], [0, 2]):
        assert best_pair(f, [images[k] for k in others], np.arange(2), FLAT, 3.0) == (0, 1)
    assert best_pair(f, images[1:], np.arange(2), FLAT, 3.0) is None  # these two are not one wall


def squares_after(imposing, f, at, vts):
    """Squared error of all VTs, in their deviations, after something was imposed, which lessens what is unknown."""
    before = np.trace(f.p)
    imposing()
    assert np.trace(f.p) < before and np.array_equal(f.p, f.p.T)
    error = f.x[at] - np.concatenate([predict(np.zeros(6), place) for _, place in vts])
    error[1::3] = wrap_angle(error[1::3])
    return error @ np.linalg.solve(f.p[at, at], error)


@pytest.mark.slow
def test_imposing_leaves_the_filter_consistent(one_filter):
    """Mean NEES of all VTs, over draws of their errors and of how flat the wall is."""
    rng, squares = np.random.default_rng(5), []
    for _ in range(300):
        turn, off = rng.normal(size=2) * [FLAT.turned, FLAT.off]
        middle_x = 12.0  # of the two visible parts
        normal = np.array([np.cos(NORTH + turn), np.sin(NORTH + turn)])
        vts = scene(NORTH + turn, normal @ [middle_x, WALL_M] + off)
        f, at = filter_of(one_filter, vts, 0.5, rng)
        squares.append(
            squares_after(partial(impose, f, partial(apart, a=pair(f)[0], b=pair(f)[1]), FLAT.covariance), f, at, vts)
        )
    # The mean of chi-square of 24 over 300 draws has a deviation of 0.4.
    assert np.mean(squares) == pytest.approx(24.0, abs=1.2)


def test_imposing_tells_nothing_of_where_the_frame_lies(one_filter):
    """Vehicle, sites and images may be shifted together: by how much, walls show next to nothing."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        f, at = filter_of(one_filter, scene(), 0.5, rng)
        away, azimuth, elevation = f.x[at].reshape(-1, 3).T
        shift = np.zeros((len(f.x), 2))
        shift[:2] = np.eye(2)
        shift[at] = jacobians(np.zeros((8, 6)), away[:, None] * unit_vector(azimuth, elevation))[0][..., :2].reshape(
            -1, 2
        )
        f.p[:] += 10.0**2 * shift @ shift.T
        impose(f, partial(apart, a=pair(f)[0], b=pair(f)[1]), FLAT.covariance)
        # Little: that of the middle of a wall, which stays where it is.
        assert np.trace(f.p[:2, :2]) == pytest.approx(2.0 * 10.0**2, rel=0.03)


def test_a_wall_of_two_images_is_their_weighted_mean(one_filter):
    f, _ = filter_of(one_filter, scene(), 0.3)
    facades = facades_of(f)
    alone = facades.estimate(f, 3)
    assert len(alone) == 6
    facades.join(f)
    walls = facades.estimate(f, 3)
    north, both = (np.flatnonzero(np.abs(some.azimuth_rad - NORTH) < 0.3) for some in (walls, alone))
    assert len(walls) == 4 and len(north) == 1  # one of the other two is shared as well
    assert walls.azimuth_rad[north] == pytest.approx(NORTH) and walls.distance_m[north] == pytest.approx(WALL_M)
    assert walls.covariance[north, 0, 0] < alone.covariance[both, 0, 0].min()
    # From x = -41, site A from the west end of the way, to x = 69, site B from the east end.
    west, east = -60 + 30 * 70 / 110, 90 - 30 * 90 / 130
    np.testing.assert_allclose(np.sort(walls.ends_m[north[0]], axis=0), [[west, WALL_M], [east, WALL_M]], rtol=1e-6)


SOUTH = (-NORTH, 90.0)  # a wall at y = -90 m, parallel to that in the north


def canyon_of(*more):
    """A site between two parallel walls, its images in them and in a third one, and VTs `more`."""
    return [
        (0, SITES[0]),
        *((0, mirrored(SITES[0], *wall)) for wall in ((), SOUTH, (0.0, 150.0))),
        *((0, at) for at in more),
    ]


def over_both(south=SOUTH):
    """The VT of paths over the wall in the north, then over that in the south."""
    return mirrored(mirrored(SITES[0]), *south)


def double_of(f, odds=5.0):
    return wall_images.likeliest_double(f, images_of(f, seen(f), 3), seen(f), FLAT, odds)


def test_a_path_over_two_parallel_walls_is_of_both(one_filter):
    # The site is at y = -30; over the north, y = 40, it is at 110; that over the south, y = -90, is at -290.
    np.testing.assert_allclose(over_both(), [-60.0, -290.0, 30.0])
    f, _ = filter_of(one_filter, canyon_of(over_both()), 0.3)
    double = double_of(f)
    assert double is not None and [double.vt.vt, double.first.vt, double.second.vt] == [4, 1, 2]
    np.testing.assert_allclose(wall_images.off(f, double).value, 0.0, atol=1e-9)


def test_double_reflections_are_imposed_once_when_walls_are_joined(one_filter):
    f, _ = filter_of(one_filter, canyon_of(over_both()), 0.3)
    facades, before = facades_of(f), np.trace(f.p)
    facades.join(f)
    after = np.trace(f.p)
    facades.join(f)
    assert after < before and np.trace(f.p) == after
    assert len(facades.estimate(f, 3)) == 3  # the double reflection is no wall of its own


@pytest.mark.parametrize(
    "more",
    [
        [over_both((-NORTH, 85.0))],  # 10 m from where it would be
        [mirrored(mirrored(SITES[0]), np.pi, 25.0)],  # over a wall of which no image of its own is known
        [],
    ],
)
def test_other_vts_are_no_double_reflections(one_filter, more):
    f, _ = filter_of(one_filter, canyon_of(*more), 0.3)
    assert double_of(f, -math.inf) is None


def test_imposing_a_double_reflection_leaves_the_filter_consistent(one_filter):
    rng, squares = np.random.default_rng(6), []
    for _ in range(300):
        # Both walls' parts that the double reflection meets are turned and set off.
        parts = [(a + FLAT.turned * rng.normal(), d + FLAT.off * rng.normal()) for a, d in ((NORTH, WALL_M), SOUTH)]
        vts = canyon_of(mirrored(mirrored(SITES[0], *parts[0]), *parts[1]))
        f, at = filter_of(one_filter, vts, 0.5, rng)
        images = {image.vt: image for image in images_of(f, seen(f), 3)}
        double = Double(vt=images[4], first=images[1], second=images[2])
        squares.append(squares_after(partial(wall_images.impose_double, f, double, seen(f), FLAT), f, at, vts))
    # Chi-square of 15 has a mean of 15 with a deviation of 0.3; the spread is a little wide on purpose.
    assert 12.5 < np.mean(squares) < 16.0


def test_where_a_wall_was_not_seen_to_reach_nothing_is_associated_with_it(one_filter):
    f, _ = filter_of(one_filter, scene(), 0.3)
    facades = facades_of(f)
    # Site B's image in the north is met at x = 27.7 + 9/13 of the vehicle's: from 6.9 m on, and with a gap from -3.1 m.
    f.x[:2] = [-44.0, 0.0]
    assert facades.not_met(f) == []
    f.x[:2] = [-45.0, 0.0]
    assert facades.not_met(f) == [15]
    facades.join(f)  # the other site shows that the wall reaches to x = -41 m
    assert facades.not_met(f) == []
