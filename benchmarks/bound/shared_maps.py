"""The bound of drives one after another through one city, which share a map: of VTs, or of walls and sites.

A drive begins with what the ones before it left of the map, and with nothing else of theirs: pose, clocks, odometry and
the array's errors are new. A map of VTs has a point for every wall and site. In a map of walls a VT is its site
mirrored in a vertical wall, so that what one site tells of a wall holds for the others.

Source: that of `cramer_rao`; walls: Leitinger, Venus, Teague and Meyer, "Data fusion for multipath-based SLAM:
combining information from multiple propagation paths", IEEE Trans. Signal Processing 71, 2023.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cellslam.benchmarks.bound.bound_model import Core, Errors, Found, Motion, Sightings, Views, Work, room
from cellslam.benchmarks.bound.cramer_rao import (
    BoundResult,
    core_of,
    drifted_std,
    most_states,
    motion_of,
    tracked_measurements,
)
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Recording, Truth

# What is known of a site, and of azimuth and distance of a wall, before the first drive: next to nothing (m; rad, m).
SITE_STD_M, WALL_STD = 300.0, (1.0, 300.0)
ONE_WAY = np.array([0.54, 0.84, 0.0])  # the side to which normals point; any that is along no street
NEVER = -1  # snapshot after which a state is not met: it stays


class Drive(NamedTuple):
    """What the recursion takes of one drive: see `bound_model`."""

    motion: Motion
    views: Views
    sightings: Sightings
    errors: Errors


def shared_map_bounds(
    recordings: Sequence[Recording], walls: bool = False, calibrated: bool = False
) -> Iterator[BoundResult]:
    """Yield the bound of each of several drives past the same sites, which share a map.

    `walls`: the map is one of walls and sites, for paths with one reflection at most; `calibrated`: the array's
    calibration is known. Raises InputError for recordings without truth, of other sites, or with clocks that drift.
    """
    from cellslam.benchmarks.bound.recursion_kernel import covariance_recursion

    _check(recordings, walls)
    core = core_of(recordings[0].odometry_model, recordings[0].sites)
    drives = [_drive(recording, core, calibrated) for recording in recordings]
    drives = _padded(list((_with_walls if walls else _with_vts)(recordings, drives)))
    work, constant = _room(drives, core), np.full(len(core.offsets), -1)
    states = core.size
    for recording, drive in zip(recordings, drives, strict=True):
        count, sites = len(recording.time_s), len(recording.sites)
        found = Found(np.zeros((count, 6, 6)), np.zeros((count, sites)), np.zeros((count, 6)))
        _begin_again(work.p, core)
        states = covariance_recursion(work, *drive, 0, count, states, constant, drifted_std(recording), found)
        yield BoundResult(found.pose, np.sqrt(np.maximum(found.offset, 0.0)), found.error)


def _check(recordings: Sequence[Recording], walls: bool) -> None:
    for recording in recordings:
        truth, first = recording.truth, recordings[0].truth
        if truth is None or first is None:
            raise InputError("a recording has no truth: the bound needs it")
        if not np.array_equal(truth.site_positions_m, first.site_positions_m):
            raise InputError("the sites of the recordings are not the same: drives that share a map share their sites")
        if drifted_std(recording).any() or recording.sites.walk_densities.any():
            raise InputError("clocks drift or walk: the bound of a shared map takes offsets for constant in a drive")
        if walls and truth.vts.order.max(initial=0) > 1:
            raise InputError("paths have two reflections: the bound with walls takes one at most (city.max_order = 1)")


def _drive(recording: Recording, core: Core, calibrated: bool) -> Drive:
    truth = _truth(recording)
    return Drive(motion_of(recording, truth, core), *tracked_measurements(recording, truth, core, calibrated))


def _with_vts(recordings: Sequence[Recording], drives: Sequence[Drive]) -> Iterator[Drive]:
    """Yield the drives with VTs of the same numbers in all of them, which stay in the map once they have been met."""
    number, met = dict[tuple[int, ...], int](), np.zeros(0, np.int64)
    for recording, drive in zip(recordings, drives, strict=True):
        vts, s = _truth(recording).vts, drive.sightings
        names = zip(vts.site.tolist(), *vts.facets.T.tolist(), strict=True)
        key = np.array([number.setdefault(name, len(number)) for name in names], np.int64)[s.key]
        first = s.first & ~np.isin(key, met)
        yield drive._replace(sightings=s._replace(key=key, first=first, last=np.zeros_like(s.last)))
        met = np.union1d(met, key)


def _with_walls(recordings: Sequence[Recording], drives: Sequence[Drive]) -> Iterator[Drive]:
    """Yield the drives with a map of sites and walls, states before those of the errors, in the place of VTs."""
    facets = np.unique(np.concatenate([_truth(recording).vts.facets[:, 0] for recording in recordings]))
    facets, sites = facets[facets >= 0], len(recordings[0].sites)
    landmarks = 3 * sites + 2 * len(facets)
    for recording, (motion, views, s, errors) in zip(recordings, drives, strict=True):
        truth = _truth(recording)
        vt = np.empty(len(views.offset), np.int64)
        vt[s.view_of] = s.key
        wall = np.where(truth.vts.order > 0, np.searchsorted(facets, truth.vts.facets[:, 0]), -1)
        state = np.concatenate(
            [3 * truth.vts.site[:, None] + np.arange(3), 3 * sites + 2 * wall[:, None] + np.arange(2)], axis=1
        )
        state[wall < 0, 3:] = -1
        load = np.einsum("nij,njk->nik", views.by_vt, _by_landmarks(truth)[vt])
        every = np.repeat(state[vt][:, None], 3, axis=1)
        old = np.where(views.state >= 0, landmarks + views.state, -1)
        nothing = np.zeros(len(s.first), np.bool_)
        yield Drive(
            motion,
            views._replace(
                by_vt=np.zeros_like(views.by_vt),
                state=np.concatenate([old, np.where(load != 0.0, every, -1)], axis=2),
                load=np.concatenate([views.load, load], axis=2),
            ),
            s._replace(first=nothing, last=nothing, state=np.where(s.state >= 0, landmarks + s.state, -1)),
            Errors(
                np.concatenate([np.full(landmarks, NEVER), errors.last]),
                np.concatenate([np.zeros(landmarks, np.int64), errors.kind]),
                errors.decay,
            ),
        )


def _by_landmarks(truth: Truth) -> Floats:
    """Return how a VT moves with its site and its wall, (V, 3, 5), for states in deviations of their priors.

    v = s - 2 (n s - d) n, n = (cos a, sin a, 0) the wall's normal and d its distance from the origin.
    """
    vts, site = truth.vts, truth.site_positions_m[truth.vts.site]
    mirrored = vts.order > 0
    away = site - vts.position_m
    out = np.zeros((len(vts), 3, 5))
    # A wall has one normal, whichever side a site is on.
    length = np.linalg.norm(away, axis=1) * np.where(away @ ONE_WAY < 0.0, -1.0, 1.0)
    n = away / np.where(mirrored, length, 1.0)[:, None]
    turned = np.stack([-n[:, 1], n[:, 0], np.zeros(len(vts))], axis=1)
    out[:, :, :3] = np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :] * mirrored[:, None, None]
    along = np.einsum("ni,ni->n", turned, site)
    out[:, :, 3] = -2.0 * along[:, None] * n - length[:, None] * turned
    out[:, :, 4] = 2.0 * n
    out[~mirrored, :, 3:] = 0.0
    scaled: Floats = out * np.array([SITE_STD_M, SITE_STD_M, SITE_STD_M, *WALL_STD])
    return scaled


def _truth(recording: Recording) -> Truth:
    assert recording.truth is not None
    return recording.truth


def _padded(drives: Sequence[Drive]) -> list[Drive]:
    """Return the drives with as many errors each, so that a VT's states have one number in all of them."""
    most = max(len(drive.errors.last) for drive in drives)
    out = []
    for drive in drives:
        last, kind, decay = drive.errors
        none = np.full(most - len(last), NEVER)
        out.append(drive._replace(errors=Errors(np.concatenate([last, none]), np.append(kind, 0 * none), decay)))
    return out


def _room(drives: Sequence[Drive], core: Core) -> Work:
    """Return the work space for any of the drives with the map of all."""
    vts = 1 + max(int(d.sightings.key.max(initial=-1)) for d in drives)
    stay = 3 * vts + max(int((d.errors.last == NEVER).sum()) for d in drives)
    rooms = [
        room(core.size, most_states(d.views, d.sightings, d.errors, len(d.motion.step)) + stay, *d[1:]) for d in drives
    ]
    shapes = [tuple(np.max([getattr(r, name).shape for r in rooms], axis=0)) for name in Work._fields]
    return Work(*(np.zeros(shape) for shape in shapes[:-2]), *(np.full(shape, -1, np.int64) for shape in shapes[-2:]))


def _begin_again(p: Floats, core: Core) -> None:
    """Forget all that is shared within a drive; what the map is off stays in the column of the filter's mean."""
    off = p[core.size :, core.mean].copy()
    p[: core.size] = 0.0
    p[:, : core.size] = 0.0
    p[core.size :, core.mean] = p[core.mean, core.size :] = off
