"""The linear model of a drive about its truth: what the bound's recursion works on.

States have numbers: first the *core*, which all measurements share (pose, odometry biases and scales, clock rates and
offsets), then three coordinates of each VT, then the errors that persist (`persisting_states`). The filter that is
linear about the truth has for states the deviations from the truth, of errors that persist the errors themselves, which
it takes for zero at first. What was really drawn on this drive, `jump` and `residual`, moves its mean: how large its
errors are, against its covariance, says whether the bound is right.

Source: the extended Kalman filter with its Jacobians at the truth, as in Taylor, "The Cramer-Rao estimation error lower
bound computation for deterministic nonlinear systems", IEEE Trans. Automatic Control 24(2), 1979.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.benchmarks.bound.persisting_states import Seen, persisting_errors
from cellslam.benchmarks.bound.recursion_kernel import Components, Sparse
from cellslam.sim.errors import InputError
from cellslam.sim.frames import held, integrate_pose, mean_velocity, pose_jacobians, wrap_angle
from cellslam.sim.lte.persisting_errors import Cause
from cellslam.sim.recording import Floats, Ints, OdometryModel, Recording, Sites, Truth
from cellslam.slam.model.measurement_model import jacobians, predict

Flags = NDArray[np.bool_]
BROAD_STD = np.array([1e4, 10.0, 10.0])  # of a component that a VT's first measurement lacks: m, rad, rad
SCATTERED_STD_M = 1e3  # how little is known of scatterers, and of a site that illuminates them, beforehand
STEP_STD_M = 1e3  # how little is known of a clock's offset after a step
SMALLEST_STD = 1e-6  # in noiseless recordings: relative for distances, rad for angles
NEVER = -1  # snapshot after which a state is not met: it stays


@dataclass(frozen=True)
class Core:
    """Where the states of the core stand: pose (0-5), odometry biases and scales, rates and offsets of clocks.

    `bias` and `scale` (6,): number of the state of each odometry component, `rate` (S,) of each site, -1: none.
    """

    bias: Ints
    scale: Ints
    rate: Ints
    offsets: Ints
    size: int


class Motion(NamedTuple):
    """How the core moves: prior variances `start` (c,), transition `F` (T, c, c) and covariance `Q` (T, c, c) of what
    is added, and `jump` (T, c): what the error of the filter's mean, estimate less truth, gains. Row t leads from
    snapshot t - 1 to t; row 0 of `jump` is the error of the priors, those of F and Q are not used."""

    start: Floats
    F: Floats
    Q: Floats
    jump: Floats


@dataclass(frozen=True)
class Views:
    """What all links share that see a VT in a snapshot, n views: loads of distance, azimuth and elevation on states,
    `state` (n, 3, W) numbers, -1: none, `load` (n, 3, W). The VT's coordinates come first: `by_vt` (n, 3, 3). Those of
    what illuminates it, if it is a scatterer, come last."""

    state: Ints
    load: Floats

    @cached_property
    def rows(self) -> Sparse:
        """The loads as a sparse matrix, a row for each component of each view."""
        there = self.state >= 0
        begin = np.concatenate([[0], np.cumsum(there.sum(axis=2).ravel())])
        return Sparse(begin, self.state[there], self.load[there])

    @property
    def by_vt(self) -> Floats:
        """Loads on the coordinates of the VT (n, 3, 3)."""
        return self.load[:, :, :3]


class Sightings(NamedTuple):
    """The measurements, m of them; snapshot t has rows[t]:rows[t + 1].

    `view_of` (m,); `vt` (m,): state of the VT's first coordinate; `first` (m,): whether it begins a VT of which nothing
    was known; `variance` (m, 3) of the white errors (infinite: not measured), `residual` (m, 3): what it is off in all;
    `state` (m, 3): the persisting error of its own (-1: none), with loads `load` (3,).
    """

    rows: Ints
    view_of: Ints
    vt: Ints
    first: Flags
    variance: Floats
    residual: Floats
    state: Ints
    load: Floats

    def components(self, chosen: Flags) -> Components:
        """Return the `chosen` (m, 3) components, in their order."""
        row = 3 * self.view_of[:, None] + np.arange(3)
        load, std = np.broadcast_to(self.load, chosen.shape), np.sqrt(self.variance[chosen])
        begin = np.concatenate([[0], np.cumsum(chosen.sum(axis=1))])[self.rows]
        return Components(begin, row[chosen], self.state[chosen], load[chosen], std, self.residual[chosen])


class Prior(NamedTuple):
    """What is known of n coordinates of VTs beforehand, by a survey or nearly nothing: `state` (n,) their numbers,
    `variance` (n,) in m^2, and `error` (n,) as it was drawn, in m."""

    state: Ints
    variance: Floats
    error: Floats


class States(NamedTuple):
    """All K states: `first` (K,) snapshot that meets an error that persists (NEVER: another state), `last` (K,) of all;
    `kind` (K,): column of `decay` (T, 4), the factor of first-order Gauss-Markov states of unit variance from a
    snapshot to the next (column 0: constants)."""

    first: Ints
    last: Ints
    kind: Ints
    decay: Floats


class Drive(NamedTuple):
    """The linear model of a drive; `vts` (V,): the number of each true VT."""

    motion: Motion
    views: Views
    sightings: Sightings
    states: States
    prior: Prior
    vts: Ints


def linear_model(
    recording: Recording, calibrated: bool = False, merging: Cause | None = None, number: Ints | None = None,
    numbers: int = 0,
) -> tuple[Core, Drive]:  # fmt: skip
    """Return the linear model of a drive with truth, and the layout of its core.

    `calibrated`, `merging`: as for `bound`; `number` (V,): which of so many `numbers` each VT has in a map of several
    drives, if there is one.
    """
    truth, core = recording.truth, core_of(recording.odometry_model, recording.sites)
    assert truth is not None
    if number is None:
        number, numbers = np.arange(len(truth.vts)), len(truth.vts)
    views, sightings, states = tracked_measurements(recording, truth, core, number, numbers, calibrated, merging)
    prior = prior_of(recording.sites, truth, core, number)
    return core, Drive(motion_of(recording, truth, core), views, sightings, states, prior, number)


# ---- the core --------------------------------------------------------------------------------------------------------


def core_of(model: OdometryModel, sites: Sites) -> Core:
    """Return the layout of the core: only errors that the data sheets have become states."""
    free = itertools.count(6)

    def numbered(there: Flags) -> Ints:
        return np.array([next(free) if one else -1 for one in there], np.int64)

    bias = numbered((model.bias > 0) | (model.bias_walk_density > 0))
    scale = numbered(model.scale > 0)
    rate = numbered((sites.drift_std_m_s > 0) | (sites.walk_densities[1] > 0))
    return Core(bias, scale, rate, numbered(np.ones(len(sites), np.bool_)), next(free))


def motion_of(recording: Recording, truth: Truth, core: Core) -> Motion:
    """Return the drive's motion about the truth, with what was drawn of its errors."""
    F, Q = linear_motion(recording, truth, core)
    return Motion(start_variance(recording, core), F, Q, jumps(recording, truth, core, F))


def start_variance(recording: Recording, core: Core) -> Floats:
    """Return the prior variances (c,) at the first snapshot, in the squared units of the states."""
    model, sites, variance = recording.odometry_model, recording.sites, np.zeros(core.size)
    variance[:6] = recording.start_std**2
    for state, std in ((core.bias, model.bias), (core.scale, model.scale), (core.rate, sites.drift_std_m_s)):
        variance[state[state >= 0]] = std[state >= 0] ** 2
    variance[core.offsets] = sites.clock_offset_std_m**2
    return variance


def linear_motion(recording: Recording, truth: Truth, core: Core) -> tuple[Floats, Floats]:
    """Return the core's transition F and the covariance Q of its noise, (T, c, c); row t leads from t - 1 to t.

    Linearised `frames.integrate_pose` at the truth, with true velocity = (measured - bias - white) / (1 + scale);
    biases walk before they act. Offsets grow by their clocks' rates. Units: those of the states (m, rad, m/s, rad/s).
    """
    count, model = len(recording.time_s), recording.odometry_model
    F, W, dt = np.tile(np.eye(core.size), (count, 1, 1)), clock_walk(recording, truth, core), np.diff(recording.time_s)
    if count < 2:
        return F, W
    velocity = mean_velocity(truth.poses[:-1], truth.poses[1:], dt)
    F[1:, :6, :6], G = pose_jacobians(truth.poses[:-1], velocity, dt)
    G = G / (1.0 + truth.odometry_scale)
    for component in range(6):
        bias, scale = core.bias[component], core.scale[component]
        if bias >= 0:
            F[1:, :6, bias] = -G[:, :, component]
            W[1:, bias, bias] = model.bias_walk_density[component] ** 2 * dt
        if scale >= 0:
            F[1:, :6, scale] = -G[:, :, component] * velocity[:, component, None]
    Q = F @ W @ np.swapaxes(F, 1, 2)
    Q[1:, :6, :6] += np.einsum("tac,tc,tbc->tab", G, model.noise_density**2 / dt[:, None], G)
    moves = core.rate >= 0
    F[1:, core.offsets[moves], core.rate[moves]] = dt[:, None]
    return F, Q


def clock_walk(recording: Recording, truth: Truth, core: Core) -> Floats:
    """Return the covariance (T, c, c), in m and m/s, of what clock offsets and rates gain: by their walks, and where a
    clock steps, at a known time, by a step of which nothing is known."""
    out, dt = np.zeros((len(recording.time_s), core.size, core.size)), np.diff(recording.time_s, prepend=np.nan)
    dt[0] = 0.0
    walk, rate_walk = recording.sites.walk_densities
    out[:, core.offsets, core.offsets] = np.outer(dt, walk**2) + np.outer(dt**3 / 3.0, rate_walk**2)
    moves = core.rate >= 0
    offset, rate, density2 = core.offsets[moves], core.rate[moves], rate_walk[moves] ** 2
    out[:, rate, rate] = np.outer(dt, density2)
    out[:, offset, rate] = out[:, rate, offset] = np.outer(dt**2 / 2.0, density2)
    if (steps := truth.clock_steps) is not None:
        at, stepped = np.searchsorted(recording.elapsed_s, steps.time_s), core.offsets[steps.site]
        np.add.at(out, (at, stepped, stepped), STEP_STD_M**2)
    return out


def jumps(recording: Recording, truth: Truth, core: Core, F: Floats) -> Floats:
    """Return what each snapshot adds to the error (T, c), estimate less truth, of the core; in the states' units.

    Row 0 is the error of the priors. After it the odometry's errors move the pose, and the biases' walks add up, over
    the transition F (T, c, c).
    """
    out = np.zeros((len(recording.time_s), core.size))
    biased, scaled = core.bias >= 0, core.scale >= 0
    out[0, :6] = recording.start_pose - truth.poses[0]
    out[0, core.bias[biased]] = -truth.odometry_bias[0, biased]
    out[0, core.scale[scaled]] = -truth.odometry_scale[scaled]
    out[0, core.offsets] = recording.sites.clock_offset_mean_m - truth.clock_offsets_m
    if len(out) > 1:
        velocity = (held(recording.odometry)[1:] - truth.odometry_bias[1:]) / (1.0 + truth.odometry_scale)
        out[1:, :6] = integrate_pose(truth.poses[:-1], velocity, np.diff(recording.time_s)) - truth.poses[1:]
    out[:, 3:6] = wrap_angle(out[:, 3:6])
    out[1:, core.bias[biased]] = -np.diff(truth.odometry_bias, axis=0)[:, biased]
    out[1:, :6] += np.einsum("tac,tc->ta", F[1:, :6, 6:], out[1:, 6:])
    return out


def vts_with_prior(sites: Sites, truth: Truth) -> Ints:
    """Return the rows (n,) of the VTs that have a prior: surveyed sites, scatterers that are measured, and what
    illuminates these. Raises InputError where this is no VT."""
    measured = np.bincount(truth.measurement_vt + 1, minlength=len(truth.vts) + 1)[1:] > 0
    scatterers = np.flatnonzero(truth.vts.scatters & measured)
    sources = truth.site_vts[np.unique(truth.vts.site[scatterers])]
    if (sources < 0).any():
        raise InputError("truth.vts has scatterers without the site that illuminates them: the bound needs it")
    vt = truth.site_vts[np.isfinite(sites.surveyed_m).all(axis=1)]
    return np.unique(np.concatenate([vt[vt >= 0], sources, scatterers]))


def prior_of(sites: Sites, truth: Truth, core: Core, number: Ints) -> Prior:
    """Return the prior of VTs: of sites that of their survey, of scatterers and of what illuminates them, if nobody
    surveyed it, a broad one about the truth; `number` (V,) as for `linear_model`."""
    vt = vts_with_prior(sites, truth)
    site, state = truth.vts.site[vt], core.size + 3 * number[vt, None] + np.arange(3)
    surveyed = ~truth.vts.scatters[vt, None] & np.isfinite(sites.surveyed_m[site])
    error = np.where(surveyed, sites.surveyed_m[site] - truth.vts.position_m[vt], 0.0)
    std = np.where(surveyed, sites.survey_std_m[site], SCATTERED_STD_M)
    return Prior(state.ravel(), std.ravel() ** 2, error.ravel())


# ---- the measurements ------------------------------------------------------------------------------------------------


class Geometry(NamedTuple):
    """What is measured of n VTs, without clock offsets: `predicted` (n, 3), and its Jacobians by the VT (n, 3, 3), the
    pose (n, 3, 6) and the position of the VT's site (n, 3, 3), which is zero unless the VT is a scatterer."""

    predicted: Floats
    by_vt: Floats
    by_pose: Floats
    by_site: Floats


def geometry_of(truth: Truth, pose: Floats, vt: Ints) -> Geometry:
    """Return what is measured of VTs (n,) from poses (n, 6); a scatterer p of a site t adds |p - t| to the distance."""
    position = truth.vts.position_m[vt]
    (by_vt, by_pose), predicted = jacobians(pose, position), predict(pose, position)
    on = np.where(truth.vts.scatters[vt, None], position - truth.site_positions_m[truth.vts.site[vt]], 0.0)
    excess_m, by_site = np.linalg.norm(on, axis=1), np.zeros_like(by_vt)
    by_site[:, 0] = -on / np.maximum(excess_m, SMALLEST_STD)[:, None]
    predicted[:, 0] += excess_m
    return Geometry(predicted, by_vt - by_site, by_pose, by_site)


def tracked_measurements(
    recording: Recording, truth: Truth, core: Core, number: Ints, numbers: int, calibrated: bool = False,
    merging: Cause | None = None,
) -> tuple[Views, Sightings, States]:  # fmt: skip
    """Return the measurements of true VTs, and all states that they meet; arguments as for `linear_model`.

    With their Jacobians and variances at the truth, and the errors that persist. The ports and sectors of a site stand
    at one place and see the same VTs. Sectors on one port differ by white noise alone: what they measure of a VT in a
    snapshot is one measurement of their joint variance, exactly.
    """
    m, vts = recording.measurements, max(len(truth.vts), 1)
    real = np.flatnonzero(truth.measurement_vt >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        all_views = geometry_of(truth, truth.poses[m.snapshot[real]], truth.measurement_vt[real])
    real = real[np.isfinite(np.concatenate(all_views[1:], axis=-1)).all(axis=(1, 2))]
    port, view = recording.links.port[m.link[real]], m.snapshot[real] * vts + truth.measurement_vt[real]
    _, at, of = np.unique(view * (port.max(initial=0) + 1) + port, return_index=True, return_inverse=True)
    snapshot, vt, port = m.snapshot[real[at]], truth.measurement_vt[real[at]], port[at]
    _, first_row = np.unique(vt, return_index=True)

    _, begin, view = np.unique(snapshot * vts + vt, return_index=True, return_inverse=True)
    predicted, by_vt, by_pose, by_site = geometry_of(truth, truth.poses[snapshot[begin]], vt[begin])
    seen = Seen(snapshot[begin], predicted[:, 1], predicted[:, 2], view, vt, port)
    persisting = persisting_errors(recording, seen, calibrated, merging)
    offset = core.offsets[recording.links.site[m.link[real[at[begin]]]]]
    errors = core.size + 3 * numbers  # the number of the first of them
    scatters, source = truth.vts.scatters[vt[begin]], number[truth.site_vts[truth.vts.site[vt[begin]]]]
    if not scatters.any():
        by_site = by_site[:, :, :0]
    coordinates = np.where(scatters[:, None], core.size + 3 * source[:, None] + np.arange(3), -1)[:, : by_site.shape[2]]
    views = Views(
        state=np.concatenate(
            [
                np.broadcast_to((core.size + 3 * number[vt[begin], None] + np.arange(3))[:, None], by_vt.shape),
                np.broadcast_to(np.arange(6), by_pose.shape),
                np.broadcast_to(offset[:, None, None], (len(begin), 3, 1)),
                np.where(persisting.state >= 0, errors + persisting.state, -1),
                np.broadcast_to(coordinates[:, None], by_site.shape),
            ],
            axis=2,
            dtype=np.int32,
            casting="same_kind",
        ),
        load=np.concatenate(
            [by_vt, by_pose, np.tile([[1.0], [0.0], [0.0]], (len(begin), 1, 1)), persisting.load, by_site], axis=2
        ),
    )
    at_view = view[of]
    white = _white_variance(recording, truth, real, predicted[at_view, 0], persisting.variance)
    variance, residual = _together(white, residuals(recording, truth, real, predicted[at_view]), of, len(at))
    first = np.isin(np.arange(len(at)), first_row) & ~np.isin(vt, vts_with_prior(recording.sites, truth))
    missing = np.where(first[:, None], BROAD_STD**2, np.inf)
    sightings = Sightings(
        rows=np.searchsorted(snapshot, np.arange(len(recording.time_s) + 1)), view_of=view,
        vt=core.size + 3 * number[vt], first=first, variance=np.where(np.isfinite(variance), variance, missing),
        residual=residual,
        state=np.where(persisting.own_state >= 0, errors + persisting.own_state, -1), load=persisting.own_load,
    )  # fmt: skip
    # VTs stay to the end: their own bound is asked for.
    states = States(
        first=np.concatenate([np.full(errors, NEVER), persisting.first]),
        last=np.concatenate([np.full(errors, NEVER), persisting.last]),
        kind=np.concatenate([np.zeros(errors, np.int64), persisting.kind]),
        decay=persisting.decay,
    )
    return views, sightings, states


def residuals(recording: Recording, truth: Truth, rows: Ints, predicted: Floats) -> Floats:
    """Return what measurements `rows` (n,) are off, distance, azimuth and elevation (n, 3) in m and rad.

    `predicted` (n, 3): of the true VTs from the true poses. What was not measured is zero. Clock offsets are taken as
    at the first snapshot: what clocks do after it is left in, for the filter to follow.
    """
    off = _values(recording, rows) - predicted
    off[:, 0] -= truth.clock_offsets_m[recording.links.site[recording.measurements.link[rows]]]
    off[:, 1:] = wrap_angle(off[:, 1:])
    return np.nan_to_num(off)


def _values(recording: Recording, rows: Ints) -> Floats:
    m = recording.measurements
    return np.stack([m.distance_m[rows], m.azimuth_rad[rows], m.elevation_rad[rows]], axis=1)


def _white_variance(recording: Recording, truth: Truth, rows: Ints, distance_m: Floats, persisting: Floats) -> Floats:
    """Return the variances (n, 3) of the white errors of measurements `rows` (n,); infinite: not measured."""
    variance = truth.measurement_std[rows] ** 2 - persisting
    if len(rows) and np.isnan(variance).all():
        raise InputError("truth.measurement_std is not known, as in a set of drives: the bound needs it")
    smallest = SMALLEST_STD * np.stack([distance_m, np.ones(len(rows)), np.ones(len(rows))], axis=1)
    there = np.isfinite(_values(recording, rows)) & np.isfinite(variance)
    return np.where(there, np.maximum(variance, smallest**2), np.inf)


def _together(variance: Floats, residual: Floats, of: Ints, count: int) -> tuple[Floats, Floats]:
    """Return variance and residual (count, 3) of what independent measurements, (n, 3) in groups `of` (n,), tell
    together."""
    with np.errstate(divide="ignore"):
        weight = 1.0 / variance
        information, weighted = (
            np.stack([np.bincount(of, column, count) for column in x.T], axis=1) for x in (weight, weight * residual)
        )
        return 1.0 / information, weighted / np.where(information > 0.0, information, 1.0)
