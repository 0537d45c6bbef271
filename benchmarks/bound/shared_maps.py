"""The bound of drives one after another through one city, which share a map of VTs.

A drive begins with what the ones before it left of the map, and with nothing else of theirs: pose, clocks, odometry and
the array's errors are new. Source: that of `cramer_rao`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from cellslam.benchmarks.bound.cramer_rao import BoundResult, Joint, recursion
from cellslam.benchmarks.bound.linear_model import linear_model
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Recording


def shared_map_bounds(recordings: Sequence[Recording], calibrated: bool = False) -> Iterator[BoundResult]:
    """Yield the bound of each of several drives past the same sites, which share a map.

    `calibrated`: the array's calibration is known. Raises InputError for recordings without truth, of other sites, or
    with clocks that drift.
    """
    sites = [_sites_m(recording) for recording in recordings]
    if not all(np.array_equal(own, sites[0]) for own in sites):
        raise InputError("the sites of the recordings are not the same: drives that share a map share their sites")
    # A VT is the same in all drives where site and facets are.
    names = [np.column_stack([r.truth.vts.site, r.truth.vts.facets]) for r in recordings if r.truth is not None]
    every, number = np.unique(np.concatenate(names), axis=0, return_inverse=True)
    numbers, known = np.split(number, np.cumsum([len(own) for own in names])[:-1]), Joint(0)
    for recording, own in zip(recordings, numbers, strict=True):
        with threadpool_limits(1):
            core, drive = linear_model(recording, calibrated, number=own, numbers=len(every))
            s = drive.sightings
            s = s._replace(first=s.first & ~np.isin(s.vt, known.there))
            result, known = recursion(core, drive._replace(sightings=s), known)
        yield result


def _sites_m(recording: Recording) -> Floats:
    """Return the sites (S, 3) of a recording whose map can be shared."""
    if recording.truth is None:
        raise InputError("a recording has no truth: the bound needs it")
    if recording.sites.drift_std_m_s.any() or recording.sites.walk_densities.any():
        raise InputError("clocks drift or walk: the bound of a shared map takes offsets for constant in a drive")
    return recording.truth.site_positions_m
