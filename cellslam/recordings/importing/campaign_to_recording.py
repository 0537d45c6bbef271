"""The recording that is made of a measured campaign: odometry between snapshots, start pose, everything checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from cellslam.recordings.importing.campaign import CLAIMS, NO_NOISE, QUANTITIES, Campaign, ReferenceTable
from cellslam.recordings.importing.odometry_resampling import Motion, at_array, mean_velocities, motion_of
from cellslam.recordings.importing.start_pose import start_from_reference
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import (
    CLOCK_PRIOR,
    COMPONENTS,
    Floats,
    Ints,
    Links,
    Measurements,
    OdometryModel,
    Recording,
    Reference,
    Sites,
)

SAME_TIME_S = 1e-6  # measurements nearer than this belong to one snapshot


def build(campaign: Campaign) -> Recording:
    """Return the recording of a campaign: rows sorted into snapshots, odometry as means between them.

    Raises InputError naming table, column and row of what cannot be used.
    """
    rows_s = _column("measurements", "time_s", campaign.time_s, None)
    _all_finite("measurements", "time_s", rows_s)
    times = _snapshot_times(campaign, rows_s)
    reference = _reference(campaign.reference)
    motion = None if campaign.odometry is None else motion_of(campaign.odometry)
    if campaign.start_pose is not None:
        start_pose = np.asarray(campaign.start_pose, np.float64)
    else:
        if reference is None:
            raise InputError("the start pose is not given, and there is no reference to take it from: give one of both")
        start_pose = start_from_reference(motion, reference, float(times[0]))
    links, sites = _links(campaign)
    return Recording(
        time_s=times,
        odometry=_odometry(motion, times, start_pose),
        odometry_model=_model(campaign.noise),
        links=links,
        sites=sites,
        measurements=_measurements(campaign, rows_s, times),
        start_pose=start_pose,
        start_std=np.asarray(campaign.start_std, np.float64),
        provenance=dict(campaign.about),
        reference=reference,
        plane=campaign.plane,
    )


def _snapshot_times(campaign: Campaign, rows_s: Floats) -> Floats:
    if campaign.snapshots_s is not None:
        times = _column("snapshots", "time_s", campaign.snapshots_s, None)
        _all_finite("snapshots", "time_s", times)
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise InputError(f"snapshots.time_s, row {late[0] + 1}: is not after the row before it: sort by time")
        return times
    times = np.unique(rows_s)
    if not len(times):
        raise InputError("measurements have no row: give at least one, or the table 'snapshots'")
    distinct: Floats = times[np.append(True, np.diff(times) > SAME_TIME_S)]
    return distinct


def _measurements(campaign: Campaign, rows_s: Floats, times: Floats) -> Measurements:
    count = len(rows_s)
    unknown = [name for name in campaign.columns if name not in (*QUANTITIES, *CLAIMS)]
    if unknown:
        raise InputError(f"measurements: unknown column '{unknown[0]}' (known: {', '.join((*QUANTITIES, *CLAIMS))})")
    if not any(name in campaign.columns for name in QUANTITIES[:3]):
        raise InputError("measurements have neither distance nor angle: give distance_m, azimuth_rad or elevation_rad")
    link = np.zeros(count, np.int64) if campaign.link is None else np.asarray(campaign.link, np.int64)
    snapshot = np.clip(np.searchsorted(times, rows_s - SAME_TIME_S), 0, len(times) - 1)
    away = np.flatnonzero(np.abs(times[snapshot] - rows_s) > SAME_TIME_S)
    if len(away):
        raise InputError(f"measurements, row {away[0]}: its time {rows_s[away[0]]} s is no time of 'snapshots'")
    order = np.lexsort((link, snapshot))
    table = {name: _column("measurements", name, values, count)[order] for name, values in campaign.columns.items()}
    for name, most in (("azimuth_rad", 2.0 * np.pi), ("elevation_rad", 0.5 * np.pi)):
        outside = np.flatnonzero(np.abs(np.asarray(campaign.columns.get(name, ()), np.float64)) > most + 1e-6)
        if len(outside):
            value = np.asarray(campaign.columns[name], np.float64)[outside[0]]
            raise InputError(
                f"measurements.{name}, row {outside[0]}: {value:.6g} rad is no such angle; were degrees taken "
                f"for radians?"
            )
    if "azimuth_rad" in table:
        table["azimuth_rad"] = wrap_angle(table["azimuth_rad"])
    nothing = np.full(count, np.nan)
    return Measurements(
        snapshot[order].astype(np.int64),
        link[order],
        *(table.get(name, nothing) for name in QUANTITIES),
        *(table.get(name) for name in CLAIMS),
    )


def _links(campaign: Campaign) -> tuple[Links, Sites]:
    names = tuple(dict.fromkeys(campaign.link_sites))
    for name in campaign.site_offsets:
        if name not in names:
            raise InputError(f"site_offsets: '{name}' is no site of a link (known: {', '.join(names)})")
    missing = np.full(len(campaign.link_sites), -1, np.int64)
    cells = missing if campaign.link_cells is None else np.asarray(campaign.link_cells, np.int64)
    ports = missing if campaign.link_ports is None else np.asarray(campaign.link_ports, np.int64)
    prior = np.zeros((len(CLOCK_PRIOR), len(names)))
    for i, name in enumerate(names):
        given = campaign.site_offsets.get(name, ())
        prior[: len(given), i] = given
    clocks = {name: row for i, (name, row) in enumerate(zip(CLOCK_PRIOR, prior, strict=True)) if i < 2 or row.any()}
    site: Ints = np.array([names.index(name) for name in campaign.link_sites], np.int64)
    return Links(site, cells, ports), Sites(names, **clocks)


def _model(noise: Mapping[str, Sequence[float]]) -> OdometryModel:
    known = ("noise_density", "bias", "bias_walk_density", "scale")
    for name in noise:
        if name not in known:
            raise InputError(f"odometry noise: unknown '{name}' (known: {', '.join(known)})")
    return OdometryModel(*(np.asarray(noise.get(name, NO_NOISE), np.float64) for name in known))


def _odometry(motion: Motion | None, times: Floats, start_pose: Floats) -> Floats:
    if motion is None:
        return np.full((len(times), len(COMPONENTS)), np.nan)
    return mean_velocities(at_array(motion), times, start_pose)


def _reference(table: ReferenceTable | None) -> Reference | None:
    if table is None:
        return None
    times = _column("reference", "time_s", table.time_s, None)
    position = np.atleast_2d(np.asarray(table.position_m, np.float64))
    if position.shape not in ((len(times), 2), (len(times), 3)):
        raise InputError(f"reference.position_m has shape {position.shape}, expected ({len(times)}, 2) or (.., 3)")
    if position.shape[1] == 2:
        position = np.column_stack([position, np.full(len(times), np.nan)])
    unknown = np.full(len(times), np.nan)
    yaw = unknown if table.yaw_rad is None else wrap_angle(_column("reference", "yaw_rad", table.yaw_rad, len(times)))
    std = unknown if table.std_m is None else np.broadcast_to(np.asarray(table.std_m, np.float64), times.shape).copy()
    return Reference(times, position, yaw, std)


def _column(table: str, name: str, values: ArrayLike, count: int | None) -> Floats:
    array = np.array(values, np.float64)
    if array.ndim != 1 or (count is not None and len(array) != count):
        raise InputError(f"{table}.{name} has shape {array.shape}, expected ({'N' if count is None else count},)")
    return array


def _all_finite(table: str, name: str, values: Floats) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(f"{table}.{name}, row {bad[0]}: is {values[bad[0]]}, not a number; leave the row out")
