"""Fusion. A fused measurement is what the links of a site measured of one path in one snapshot.

The ports and sectors of a site stand at one place, and see a path under the same distance and direction: what they
measure of it differs by white noise, and from port to port by errors of place. The twelve links of two sites measure
most paths six times; the mean of the six is one fused measurement. Clutter of one link is rarely seen by another, so
that the number of links that agree tells paths from clutter.

Sources: Bar-Shalom and Li, "Multitarget-multisensor tracking", 1995 (normalised distance, nearest neighbour), and the
variance of a weighted mean; white noise: paper, eq. 34 (its Q is R here), corrected to R = R_floor + R_0 / lambda: a
higher SNR lambda means a smaller variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.measurements.measurement_options import MeasurementOptions

Options = TypeVar("Options", bound=MeasurementOptions)
TOGETHER = 16.3  # squared distance of two measurements of one path over its variance, at most
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
        site, cell_id, port = (np.array(c, np.int64)[self._first] for c in (links.site, links.cell_id, links.port))
        self.setup = replace(setup, links=Links(site, cell_id, port))

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
            vts = replace(vts, link=self._first[vts.link])
        return replace(estimate, association=association, vts=vts)


def white(snapshot: Snapshot, options: MeasurementOptions) -> Floats:
    """Return the white variances (m, 3) of distance (m^2), azimuth and elevation (rad^2) of a snapshot's measurements.

    With noise_model "claimed" the front end's own deviations are taken where it gives them, less the errors that
    persist. A measurement without SNR gets the floor and the variance at 0 dB.
    """
    floor, unit = options.noise
    out = floor + unit * np.where(np.isnan(snapshot.snr_db), 1.0, 10.0 ** (-0.1 * snapshot.snr_db))[:, None]
    if options.noise_model == "claimed":
        columns = (snapshot.distance_std_m, snapshot.azimuth_std_rad, snapshot.elevation_std_rad)
        lasting = np.sum(options.persisting, axis=0)
        for i, column in enumerate(columns):
            if column is not None:
                own = np.maximum(column**2 - lasting[i], 0.01 * column**2)
                out[:, i] = np.where(np.isfinite(column), own, out[:, i])
    return np.asarray(out)


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


@njit(cache=True)
def taken_together(
    distance: Floats, azimuth: Floats, elevation: Floats, white: Floats, place: Floats, link: Ints, group_of: Ints,
    port_of: Ints, together: bool,
) -> tuple[Floats, Floats, Ints, Ints, Ints, Ints, Ints]:  # fmt: skip
    """Return the n fused measurements of m measurements, sorted by group: their values (n, 3), white variances (n, 3),
    group (n,), number of members (n,) and of ports (n,), and first member (n,); and which of them each measurement is a
    member of (m,).

    distance (m,) in m, azimuth and elevation (m,) in rad; white (m, 3): variances; place (3,): those of errors that
    differ from port to port; link (m,), sorted; group_of, port_of (L,). Where `together` is false, each measurement is
    fused with no other.
    """
    m = len(link)
    z = np.empty((m, 3))
    for i in range(m):
        z[i, 0], z[i, 1], z[i, 2] = distance[i], azimuth[i], elevation[i]
    if together:
        fused_of, fused = group(z, white + 2.0 * place, link, group_of)
    else:
        fused_of, fused = np.arange(m), m
    lead, count = np.full(fused, -1), np.zeros(len(group_of) + 1, np.int64)
    for i in range(m):
        if lead[fused_of[i]] < 0:
            lead[fused_of[i]] = i
            count[group_of[link[i]] + 1] += 1
    count = np.cumsum(count)
    first, own = np.empty(fused, np.int64), np.empty(fused, np.int64)
    number = np.empty(fused, np.int64)
    for n in range(fused):
        g = group_of[link[lead[n]]]
        number[n] = count[g]
        own[count[g]], first[count[g]] = g, lead[n]
        count[g] += 1
    for i in range(m):
        fused_of[i] = number[fused_of[i]]
    mean, variance, members, ports = means(z, white, link, port_of, fused_of, first)
    return mean, variance, own, members, ports, first, fused_of


@part
def group(z: Floats, variance: Floats, link: Ints, group_of: Ints) -> tuple[Ints, int]:
    """Return which fused measurement each measurement is a member of (m,), and how many fused ones there are.

    z (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured; variance (m, 3): of each, without what
    all measurements of a path have in common; link (m,): sorted; group_of (L,): links of one group see the same paths,
    a path at most once each. A fused measurement is where its members are in the mean. Of all pairs of a measurement of
    a link and a fused measurement, the closest is joined first.
    """
    m = len(link)
    fused_of, own, taken = np.empty(m, np.int64), np.empty(m, np.int64), np.zeros(m, np.int64)
    centre, spread, members = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3))
    fused, start = 0, 0
    while start < m:
        stop = start
        while stop < m and link[stop] == link[start]:
            fused_of[stop] = -1
            stop += 1
        before = fused
        taken[:before] = 0
        while True:
            best, which, where = TOGETHER, -1, -1
            for k in range(start, stop):
                if fused_of[k] >= 0:
                    continue
                for c in range(before):
                    if taken[c] == 1 or own[c] != group_of[link[start]]:
                        continue
                    apart = _apart(z[k], variance[k], centre[c], spread[c])
                    if apart < best:
                        best, which, where = apart, k, c
            if which < 0:
                break
            fused_of[which], taken[where] = where, 1
            _join(z[which], variance[which], centre[where], spread[where], members[where])
        for k in range(start, stop):
            if fused_of[k] < 0:
                fused_of[k], own[fused] = fused, group_of[link[start]]
                _join(z[k], variance[k], centre[fused], spread[fused], members[fused])
                fused += 1
        start = stop
    return fused_of, fused


@part
def means(
    z: Floats, white: Floats, link: Ints, port_of: Ints, fused_of: Ints, first: Ints
) -> tuple[Floats, Floats, Ints, Ints]:
    """Return the n fused measurements of measurements z (m, 3): means (n, 3) of their members, white variances (n, 3),
    number of members (n,) and of ports (n,).

    The measurements of one port count alike, and ports count alike. link (m,); fused_of (m,): the fused
    measurement of each; port_of (L,); first (n,): one member of each fused measurement.
    """
    m, fused = len(link), len(first)
    mean, variance, whole = np.zeros((fused, 3)), np.zeros((fused, 3)), np.zeros((fused, 3))
    members, ports = np.zeros(fused, np.int64), np.zeros(fused, np.int64)
    for i in range(m):
        n, alike, before = fused_of[i], 0, 0
        for j in range(m):
            if fused_of[j] == n and port_of[link[j]] == port_of[link[i]]:
                alike += 1
                before += 1 if j < i else 0
        members[n] += 1
        ports[n] += 1 if before == 0 else 0
        weight = 1.0 / alike
        for c in range(3):
            if math.isnan(z[i, c]):
                continue
            gap = z[i, c]
            if c == 1 and not math.isnan(z[first[n], 1]):
                gap -= z[first[n], 1]
                gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
            mean[n, c] += weight * gap
            variance[n, c] += weight * weight * white[i, c]
            whole[n, c] += weight
    for n in range(fused):
        for c in range(3):
            if whole[n, c] == 0.0:
                mean[n, c], variance[n, c] = math.nan, white[first[n], c]
                continue
            mean[n, c] /= whole[n, c]
            variance[n, c] /= whole[n, c] * whole[n, c]
        if not math.isnan(z[first[n], 1]):
            mean[n, 1] += z[first[n], 1]
    return mean, variance, members, ports


@part
def _apart(z: Floats, variance: Floats, centre: Floats, spread: Floats) -> float:
    """Return the squared distance of a measurement from a fused one, over its variance."""
    total = 0.0
    for c in range(3):
        gap = z[c] - centre[c]
        if math.isnan(gap):
            continue
        if c == 1:
            gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
        total += gap * gap / (variance[c] + spread[c])
    return total


@part
def _join(z: Floats, variance: Floats, centre: Floats, spread: Floats, members: Floats) -> None:
    """Take a measurement into the mean of a fused one, which begins with the first that has a component."""
    for c in range(3):
        if members[c] == 0.0:
            centre[c], spread[c] = z[c], variance[c]
        if math.isnan(z[c]):
            continue
        members[c] += 1.0
        gap = z[c] - centre[c]
        if c == 1:
            gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
        centre[c] += gap / members[c]
        spread[c] += (variance[c] - spread[c]) / members[c]
