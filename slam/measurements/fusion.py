"""Fusion. A fused measurement is what the links of a site measured of one path in one snapshot.

The ports and sectors of a site stand at one place, and see a path under the same distance and direction: what they
measure of it differs by white noise, and from port to port by errors of place. The twelve links of two sites measure
most paths six times; the mean of the six is one fused measurement. Clutter of one link is rarely seen by another, so
that the number of links that agree tells paths from clutter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.measurements.fusion_kernel import taken_together
from cellslam.slam.measurements.measurement_noise import white
from cellslam.slam.measurements.measurement_options import MeasurementOptions

Options = TypeVar("Options", bound=MeasurementOptions)

MANY = 3  # links of a site from which on their number decides whether a fused measurement may begin a VT
COINCIDENCE = 0.1  # probability that clutter of a link has clutter of one more link beside it
UNUSUAL = 0.1  # share of paths that any number of links detect alike, because obstacles hide them from some
UNMAPPED = 0.01  # share of paths that are not in the map yet: at best so much less likely than a VT is clutter
BIRTH_RATIO = 0.5  # probability that an unexplained fused measurement of many links is of a new VT
LARGEST_DETECTION = 0.985  # probability that at least one of many links detects a path: not all misses are independent


@dataclass(frozen=True, kw_only=True, repr=False)
class FusedMeasurements(Snapshot):
    """A snapshot of n fused measurements, sorted by the group of links that they belong to (`link`).

    `white` (n, 3): white variances in m^2 and rad^2; `ports` (n,): of how many ports each is the mean;
    `clutter_log_ratio` (n,): log of how much likelier clutter has so many members than a path; `begins` (n,): whether
    it may begin a VT; `row` (n,): that of its first member; `of` (m,): for each of the m measurements that were fused,
    the index of the fused measurement that it is a member of.
    """

    white: Floats
    ports: Ints
    clutter_log_ratio: Floats
    begins: NDArray[np.bool_]
    of: Ints


class Fusion(Generic[Options]):
    """Which links are taken together. `setup` and `options` as the estimator is to see them: a link for each group."""

    def __init__(self, setup: Setup, options: Options) -> None:
        """Take the links of each site together, or every link by itself where `options.sharing` is "none"."""
        links = setup.links
        site, self._port = np.array(links.site, np.int64), np.array(links.port, np.int64)
        key = site if options.sharing == "site" else np.arange(len(site))
        _, self._first, self._group = np.unique(key, return_index=True, return_inverse=True)
        share = max(len(site), 1) / max(len(self._first), 1)
        self._together, self._given, size = share > 1.0, options, np.bincount(self._group)
        self._clutter_log_ratios = clutter_log_ratios(size, options.detection_probability)
        self._begins = (self._clutter_log_ratios <= 0.0) | (size < MANY)[:, None]
        missed = (1.0 - options.detection_probability) ** share
        self.options: Options = options.model_copy(update={
            "detection_probability": max(min(1.0 - missed, LARGEST_DETECTION), options.detection_probability),
            "clutter_density": options.clutter_density * share,
            "birth_ratio": max(BIRTH_RATIO, options.birth_ratio) if (size >= MANY).all() else options.birth_ratio,
        })  # fmt: skip
        columns = (np.array(c, np.int64)[self._first] for c in (links.site, links.cell_id, links.port))
        self.setup = replace(setup, links=Links(*columns))

    def fuse(self, snapshot: Snapshot) -> FusedMeasurements:
        """Return the measurements of a snapshot, fused."""
        z, noise, own, members, ports, first, fused_of = taken_together(
            snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad, white(snapshot, self._given),
            self._given.persisting[0], snapshot.link, self._group, self._port, self._together,
        )  # fmt: skip
        distance_m, azimuth_rad, elevation_rad = np.ascontiguousarray(z.T)
        return FusedMeasurements(
            index=snapshot.index, row=snapshot.row[first], link=own, distance_m=distance_m, azimuth_rad=azimuth_rad,
            elevation_rad=elevation_rad, snr_db=snapshot.snr_db[first], white=noise, ports=ports,
            clutter_log_ratio=self._clutter_log_ratios[own, members], begins=self._begins[own, members], of=fused_of,
        )  # fmt: skip

    def answer(self, estimate: Estimate, fused: FusedMeasurements) -> Estimate:
        """Return an answer to fused measurements as an answer to the measurements that are their members."""
        association, vts = estimate.association, estimate.vts
        if association is not None:
            association = association[fused.of]
        if vts is not None:
            vts = VtEstimate(vts.id, self._first[vts.link], vts.position_m, vts.covariance)
        return replace(estimate, association=association, vts=vts)


def clutter_log_ratios(links: Ints, detection_probability: float) -> Floats:
    """Return ln P(members | clutter) / P(members | path) by group (G,) of so many links, and number of members.

    A log-likelihood ratio (G, links + 1). Of what a path detects the number is binomial, of clutter geometric. Where
    many agree it is no clutter, but may be of a VT that is not in the map: that alternative bounds what agreement
    tells. Source: own derivation: Bayes' rule for these two distributions.
    """
    out = np.zeros((len(links), int(links.max(initial=0)) + 1))
    for g, count in enumerate(links):
        n = np.arange(1, count + 1)
        path = binom(count, n) * detection_probability**n * (1.0 - detection_probability) ** (count - n)
        clutter = COINCIDENCE ** (n - 1.0)
        path = (1.0 - UNUSUAL) * path / path.sum() + UNUSUAL / count
        if count > 1:
            out[g, n] = np.log(clutter / clutter.sum() / path + UNMAPPED)
    return out
