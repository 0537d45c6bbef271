"""A measured campaign in SI units, each table at its own times, and the recording that is made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cellslam.recordings.importing.odometry import (
    OdometryTable,
    column_of,
    mean_velocities,
    motion_of,
    times_of,
    to_fixes,
)  # fmt: skip
from cellslam.recordings.importing.start_pose import start_from_reference
from cellslam.sim import recording as contract
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import CLOCK_PRIOR, COMPONENTS, Floats, Recording, Reference

QUANTITIES = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db")
DEVIATIONS = ("distance_std_m", "azimuth_std_rad", "elevation_std_rad")
KINDS_OF_NOISE = ("noise_density", "bias", "bias_walk_density", "scale")  # of a data sheet
NOTHING = (0.0,) * 6
SAME_TIME_S = 1e-6  # measurements nearer than this belong to one snapshot
# A clock off by 1e-4 is the least of it: what is measured is the time of a threshold in an envelope, which comes the
# later the weaker the path, and with it the farther; ranging radios have been found long or short by up to 6 %.
RANGE_SCALE_STD = 0.04
LEAST_SHARED = 0.2  # of the shorter of two tables' spans: a late start or an early end of one leaves more
SLACK_S = 1.0  # drives of a moment: a table that begins so much later is not of another clock
GPS_TO_UNIX_S = 315_964_782  # the epoch of GPS time, less the leap seconds since (18 from 2017 on)
LARGEST_ANGLE = {"azimuth_rad": 2.0 * np.pi, "elevation_rad": 0.5 * np.pi}


@dataclass(frozen=True)
class ReferenceTable:
    """Known positions (R, 2) or (R, 3) of the array in metres at times (R,); yaw and deviation (R,) where known."""

    time_s: ArrayLike
    position_m: ArrayLike
    yaw_rad: ArrayLike | None = None
    std_m: ArrayLike | float | None = None


@dataclass(frozen=True)
class Campaign:
    """What was measured: each table with its own times, all on one clock, in metres, radians, seconds, dB.

    `time_s` (M,) and `columns`: a row a path; those of `QUANTITIES` and `DEVIATIONS` that exist; `link` (M,) indexes
    `link_sites`, the site of each link. `site_offsets`: by site, the prior of the clock offset (mean, std) in
    metres and as many as there are of the further columns of `CLOCK_PRIOR`; a site whose clock is known has (0, 0).
    `site_surveys`: by site, where it stands and, if the survey errs, the deviations: (x, y, z) or (x, y, z, std x, std
    y, std z) in metres; a site that is not in it was not surveyed. `link_azimuths`: where each sector's antenna points,
    rad counter-clockwise from east, NaN where it is not known.
    `start_pose`: None takes it from the reference. `start_std`: its deviations; NaN: as the reference has them, 0 where
    the pose is given. `snapshots_s`: times of all snapshots, empty ones too; None: the times of the measurements.
    `noise`: OdometryModel's fields by name, each (6,). `range_scale_std`: deviation of the scale by which all distances
    may be measured too long; 0: it is known to be right. `scatterers`: whether points may scatter paths, beside walls
    that mirror them; False for landmarks that are measured themselves.
    """

    time_s: ArrayLike
    columns: Mapping[str, ArrayLike]
    odometry: OdometryTable | None = None
    link: ArrayLike | None = None
    link_sites: Sequence[str] = ("site",)
    link_cells: Sequence[int] | None = None
    link_ports: Sequence[int] | None = None
    link_azimuths: Sequence[float] | None = None
    site_offsets: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    site_surveys: Mapping[str, Sequence[float]] = field(default_factory=dict)
    noise: Mapping[str, Sequence[float]] = field(default_factory=dict)
    start_pose: Sequence[float] | None = None
    start_std: Sequence[float] = (np.nan,) * 6
    reference: ReferenceTable | None = None
    snapshots_s: ArrayLike | None = None
    plane: bool = False
    range_scale_std: float = RANGE_SCALE_STD
    scatterers: bool = True
    about: Mapping[str, Any] = field(default_factory=dict)


def build(campaign: Campaign) -> Recording:
    """Return the recording of a campaign: rows sorted into snapshots, odometry as means between them.

    Raises InputError naming table, column and row of what cannot be used.
    """
    rows_s = times_of("measurements", campaign.time_s, in_order=False)
    times = _snapshot_times(campaign, rows_s)
    reference = None if campaign.reference is None else _reference(campaign.reference)
    motion = None if campaign.odometry is None else motion_of(campaign.odometry)
    if motion is not None:
        _check_shared("odometry", motion.edges_s, times)
    if reference is not None:
        _check_shared("reference", reference.time_s, times)
    if campaign.start_pose is not None:
        start_pose, start_std = np.asarray(campaign.start_pose, np.float64), np.zeros(6)
    elif reference is not None:
        start_pose, start_std = start_from_reference(motion, reference, float(times[0]))
    else:
        raise InputError("the start pose is not given, and there is no reference to take it from: give one of both")
    if reference is not None and motion is not None:
        reference = replace(reference, odometry=to_fixes(motion, times, reference.time_s, start_pose))
    nothing = np.full((len(times), len(COMPONENTS)), np.nan)
    links, sites = _links(campaign)
    return Recording(
        time_s=times,
        odometry=nothing if motion is None else mean_velocities(motion, times, start_pose),
        odometry_model=_model(campaign),
        links=links,
        sites=sites,
        measurements=_measurements(campaign, rows_s, times),
        start_pose=start_pose,
        start_std=np.where(np.isnan(campaign.start_std), start_std, campaign.start_std),
        provenance=dict(campaign.about),
        reference=reference,
        plane=campaign.plane,
        range_scale_std=campaign.range_scale_std * ("distance_m" in campaign.columns),
        scatterers=campaign.scatterers and {"distance_m", "azimuth_rad"} <= campaign.columns.keys(),
    )


def _snapshot_times(campaign: Campaign, rows_s: Floats) -> Floats:
    if campaign.snapshots_s is not None:
        return times_of("snapshots", campaign.snapshots_s)
    times = np.unique(rows_s)
    if not len(times):
        raise InputError("measurements have no row: give at least one, or the table 'snapshots'")
    distinct: Floats = times[np.append(True, np.diff(times) > SAME_TIME_S)]
    return distinct


def _check_shared(table: str, own_s: Floats, times: Floats) -> None:
    """Raise InputError where a table's times (N,) in s share no time with the snapshots' (T,), or little."""
    shared = min(own_s[-1], times[-1]) - max(own_s[0], times[0])
    if shared + SLACK_S < LEAST_SHARED * min(own_s[-1] - own_s[0], times[-1] - times[0]):
        raise InputError(
            f"{table} lasts from {own_s[0]:.15g} to {own_s[-1]:.15g} s, measurements from {times[0]:.15g} to "
            f"{times[-1]:.15g} s: they share {f'{shared:.3g} s' if shared > 0.0 else 'no time'}; check the unit of "
            f"time_s, and bring both onto one clock with [clocks.NAME] offset_s (from GPS to Unix time {GPS_TO_UNIX_S})"
        )


def _measurements(campaign: Campaign, rows_s: Floats, times: Floats) -> contract.Measurements:
    count = len(rows_s)
    for name in campaign.columns:
        if name not in (*QUANTITIES, *DEVIATIONS):
            raise unknown_name("column of measurements", name, (*QUANTITIES, *DEVIATIONS))
    if not any(name in campaign.columns for name in QUANTITIES[:3]):
        raise InputError("measurements have neither distance nor angle: give distance_m, azimuth_rad or elevation_rad")
    link = np.zeros(count, np.int64) if campaign.link is None else np.asarray(campaign.link, np.int64)
    snapshot = np.clip(np.searchsorted(times, rows_s - SAME_TIME_S), 0, len(times) - 1)
    away = np.flatnonzero(np.abs(times[snapshot] - rows_s) > SAME_TIME_S)
    if len(away):
        raise InputError(f"measurements, row {away[0]}: its time {rows_s[away[0]]} s is no time of 'snapshots'")
    order = np.lexsort((link, snapshot))
    table = {}
    for name, values in campaign.columns.items():
        column = column_of("measurements", name, values, count)
        outside = np.flatnonzero(np.abs(column) > LARGEST_ANGLE.get(name, np.inf) + 1e-6)
        if len(outside):
            raise InputError(
                f"measurements.{name}, row {outside[0]}: {column[outside[0]]:.6g} rad is no such angle; were degrees "
                "taken for radians?"
            )
        table[name] = wrap_angle(column[order]) if name == "azimuth_rad" else column[order]
    nothing = np.full(count, np.nan)
    quantities = (table.get(name, nothing) for name in QUANTITIES)
    claims = (table.get(name) for name in DEVIATIONS)
    return contract.Measurements(snapshot[order].astype(np.int64), link[order], *quantities, *claims)


def _links(campaign: Campaign) -> tuple[contract.Links, contract.Sites]:
    names = tuple(dict.fromkeys(campaign.link_sites))
    for argument in ("site_offsets", "site_surveys"):
        for name in getattr(campaign, argument):
            if name not in names:
                raise InputError(f"{argument}: '{name}' is no site of a link (known: {', '.join(names)})")
    missing = np.full(len(campaign.link_sites), -1, np.int64)
    cells = missing if campaign.link_cells is None else np.asarray(campaign.link_cells, np.int64)
    ports = missing if campaign.link_ports is None else np.asarray(campaign.link_ports, np.int64)
    prior = np.zeros((len(CLOCK_PRIOR), len(names)))
    for i, name in enumerate(names):
        given = campaign.site_offsets.get(name, ())
        prior[: len(given), i] = given
    clocks = {name: row for i, (name, row) in enumerate(zip(CLOCK_PRIOR, prior, strict=True)) if i < 2 or row.any()}
    site = np.array([names.index(name) for name in campaign.link_sites], np.int64)
    azimuth = None
    if campaign.link_azimuths is not None and np.isfinite(campaign.link_azimuths).any():
        azimuth = wrap_angle(np.asarray(campaign.link_azimuths, np.float64))
    return contract.Links(site, cells, ports, azimuth), contract.Sites(names, **clocks, **_surveys(campaign, names))


def _surveys(campaign: Campaign, names: Sequence[str]) -> dict[str, Floats]:
    """Return the columns of the sites (S,) that say what a survey knows; none where there was no survey."""
    if not campaign.site_surveys:
        return {}
    survey = np.tile([np.nan, np.nan, np.nan, 0.0, 0.0, 0.0], (len(names), 1))
    for name, given in campaign.site_surveys.items():
        if len(given) not in (3, 6):
            raise InputError(f"site_surveys: '{name}' has {len(given)} numbers: give x, y, z, or their deviations, too")
        survey[names.index(name), : len(given)] = given
    return {"position_m": survey[:, :3].copy(), "position_std_m": survey[:, 3:].copy()}


def _model(campaign: Campaign) -> contract.OdometryModel:
    for name in campaign.noise:
        if name not in KINDS_OF_NOISE:
            raise unknown_name("kind of noise", name, KINDS_OF_NOISE)
    rows = {name: np.asarray(campaign.noise.get(name, NOTHING), np.float64) for name in KINDS_OF_NOISE}
    odometry = campaign.odometry
    return contract.OdometryModel(**rows, time_constant_s=None if odometry is None else odometry.time_constant_s)


def _reference(table: ReferenceTable) -> Reference:
    times = column_of("reference", "time_s", table.time_s)
    position = np.atleast_2d(np.asarray(table.position_m, np.float64))
    if position.shape not in ((len(times), 2), (len(times), 3)):
        raise InputError(f"reference.position_m has shape {position.shape}, expected ({len(times)}, 2) or (.., 3)")
    unknown = np.full(len(times), np.nan)
    position = np.column_stack([position, unknown])[:, :3]
    yaw = unknown
    if table.yaw_rad is not None:
        yaw = wrap_angle(column_of("reference", "yaw_rad", table.yaw_rad, len(times)))
    std = unknown if table.std_m is None else np.broadcast_to(np.asarray(table.std_m, np.float64), times.shape).copy()
    return Reference(times, position, yaw, std)
