"""A whole drive in a world as a recording, with the truth: what estimators are given, and what they are scored by."""

from __future__ import annotations

import platform
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, held, wrap_angle
from cellslam.sim.lte.faults import Reports, as_reported, walk_densities
from cellslam.sim.lte.links import links_of
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Links, Recording, Sites, Truth, Vehicles, VirtualTransmitters
from cellslam.sim.traffic import Blocked, reflecting_vehicle
from cellslam.sim.vehicle import Odometry
from cellslam.sim.world.world import Reception, WorldConfig, prepare

if TYPE_CHECKING:
    from cellslam.sim.lte.statistical.statistical_front_end import Detections
    from cellslam.sim.rays import Paths


def simulate(
    config: WorldConfig, seed: int, trial: int, progress: Progress = silent, place: int | None = None
) -> Recording:
    """Return the recording of trial `trial` of root seed `seed`, truth included. Same arguments, same
    recording. `place` as of `prepare`.
    """
    world = prepare(config, seed, trial, progress, place)
    odometry, reports = world.odometry(), world.reports()
    late_s = None if reports is None else reports.late_s
    detections, paths, blocked = world.measure_drive(world.streams(), progress, held(odometry.velocity), late_s)
    recording, reported = recorded(world, odometry, detections, paths, reports, blocked.free(len(paths)))
    if world.traffic is None or recording.truth is None:
        return recording
    _, path_vt = virtual_transmitters(paths)
    vehicles = Vehicles(
        **vars(world.traffic),
        blocked=_blocked_intervals(blocked, path_vt, paths.receiver),
        reflected=np.append(reflecting_vehicle(paths.facets), -1)[reported.path],
    )
    return replace(recording, truth=replace(recording.truth, vehicles=vehicles))


def recorded(
    world: Reception, odometry: Odometry, detections: Detections, paths: Paths, reports: Reports | None,
    free: NDArray[np.bool_] | None = None,
) -> tuple[Recording, Detections]:  # fmt: skip
    """Return the recording of a drive, truth included, and its detections as they are reported. `free` (P,): which of
    the paths exist, None for all; `reports`: when snapshots are reported, None: in time."""
    from cellslam.sim.lte.persisting_errors import persisting_std

    config = world.config
    if reports is not None:
        detections = as_reported(detections, reports)
    vts, path_vt = virtual_transmitters(paths, free)
    vts = with_sites(vts, world.sites_m)
    measurement_vt = np.where(detections.path >= 0, path_vt[detections.path] if len(path_vt) else -1, -1)
    true_std = np.where(measurement_vt[:, None] >= 0, detections.true_std, np.nan)
    truth = Truth(
        poses=world.drive.poses,
        measurement_vt=measurement_vt.astype(np.int64),
        measurement_std=true_std,
        vts=vts,
        site_positions_m=world.sites_m,
        clock_offsets_m=world.offsets_m,
        clock_drift_m_s=world.drift_m_s if config.radio.clock_drift > 0.0 else None,
        odometry_bias=odometry.bias,
        odometry_scale=odometry.scale,
        persisting_std=np.where(np.isnan(true_std), np.nan, persisting_std(config.radio)),
        merging_shift=(
            np.where(np.isnan(true_std), np.nan, detections.merging_shift)
            if config.radio.front_end == "statistical"
            else None
        ),
        clock_wander_m=None if world.clock_errors is None else world.clock_errors.wander_m,
        clock_steps=None if world.clock_errors is None else world.clock_errors.steps,
        odometry_slip=odometry.slip,
        age_s=None if reports is None else reports.age_s(world.drive.time_s),
    )
    links, sites = known_of(world)
    recording = Recording(
        time_s=world.drive.time_s,
        odometry=odometry.velocity,
        odometry_model=odometry.model,
        links=links,
        sites=sites,
        measurements=detections.measurements,
        start_pose=world.start_pose,
        start_std=np.array(config.vehicle.start_std, np.float64),
        provenance=provenance(config, world.seed, world.trial),
        truth=truth,
        scatterers=config.radio.scatterers > 0.0,
    )
    return recording, detections


def known_of(world: Reception) -> tuple[Links, Sites]:
    """Return what is known of the links and of their sites beforehand."""
    config, count = world.config, len(world.config.sites)
    drift = np.full(count, SPEED_OF_LIGHT_MPS * config.radio.clock_drift) if config.radio.clock_drift > 0.0 else None
    offset, radio = np.full(count, config.radio.clock_offset_std_m), config.radio
    sites = Sites(tuple(site.name for site in config.sites), np.zeros(count), offset, drift)
    if radio.clock_oscillator != "ideal":
        walk, rate_walk = (np.full(count, density) for density in walk_densities(radio.clock_oscillator))
        sites = replace(sites, clock_walk_m_sqrt_s=walk, clock_drift_walk_m_s_sqrt_s=rate_walk)
    if radio.clock_steps_per_hour > 0.0 or radio.clock_step_times_s:
        sites = replace(sites, clock_step_std_m=np.full(count, radio.clock_step_std_m))
    links, known = links_of(world.cells), np.array([site.known for site in config.sites])
    if known.any():
        std_m = np.array([[site.survey_std_m] * 3 for site in config.sites])
        sites = replace(sites, position_m=world.surveyed_m, position_std_m=std_m)
        cell_azimuth = np.repeat(world.cells.azimuth_rad, world.cells.ports)
        links = replace(links, azimuth_rad=np.where(known[links.site], wrap_angle(cell_azimuth), np.nan))
    return links, sites


def provenance(config: WorldConfig, seed: int, trial: int) -> dict[str, Any]:
    """Return what is needed to make a recording again: resolved world, root seed, trial, versions. JSON-able."""
    return {"world": config.model_dump(mode="json"), "seed": seed, "trial": trial, "versions": versions()}


def versions() -> dict[str, str]:
    """Return the versions of what recordings and rows depend on."""
    packages = ("cellslam", "numpy", "numba", "scipy", "embreex", "highway-env")
    return {name: version(name) for name in packages} | {"python": platform.python_version()}


def virtual_transmitters(paths: Paths, free: NDArray[np.bool_] | None = None) -> tuple[VirtualTransmitters, Ints]:
    """Return the VTs of a drive's paths, one per (site, facets), with their visible intervals, and the VT of each path
    (P,), -1 if a vehicle reflects it. `free` (P,): which paths exist, None for all; a VT may have none of these.
    """
    from cellslam.sim.rays.scattering import scatterer_of

    still = np.flatnonzero(reflecting_vehicle(paths.facets) < 0)
    key = np.column_stack([paths.transmitter, paths.facets, paths.edge])[still]
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    path_vt = np.full(len(paths), -1, np.int64)
    path_vt[still], first = inverse.reshape(-1), still[first]
    exists = (path_vt >= 0) & (True if free is None else free)
    scatters = scatterer_of(paths.facets[first]) >= 0
    vts = VirtualTransmitters(
        position_m=np.where(scatters[:, None], paths.points_m[first, 0], paths.vt_position_m[first]),
        site=paths.transmitter[first].astype(np.int64),
        order=paths.order[first].astype(np.int64),
        facets=paths.facets[first].astype(np.int64),
        visible=visible_intervals(path_vt[exists], paths.receiver[exists]),
        scatterer=scatters.astype(np.int64) if scatters.any() else None,
    )
    return vts, path_vt


def with_sites(vts: VirtualTransmitters, sites_m: Floats) -> VirtualTransmitters:
    """Return VTs and, where points scatter, the sites (S, 3) in m that no line of sight leads to: they illuminate."""
    if vts.scatterer is None:
        return vts
    hidden = np.setdiff1d(np.unique(vts.site[vts.scatterer == 1]), vts.site[vts.order == 0])
    none = np.zeros(len(hidden), np.int64)
    return VirtualTransmitters(
        position_m=np.concatenate([vts.position_m, sites_m[hidden]]),
        site=np.append(vts.site, hidden),
        order=np.append(vts.order, none),
        facets=np.concatenate([vts.facets, np.full((len(hidden), 2), -1)]),
        visible=vts.visible,
        scatterer=np.append(vts.scatterer, none),
    )


def visible_intervals(vt: Ints, snapshot: Ints) -> Ints:
    """Return (I, 3): VT, first and last snapshot of each run of consecutive snapshots in which the VT has a path."""
    order = np.lexsort((snapshot, vt))
    v, t = vt[order], snapshot[order]
    new = np.ones(len(v), bool)
    new[1:] = (np.diff(v) != 0) | (np.diff(t) > 1)
    last = np.append(np.flatnonzero(new)[1:] - 1, len(v) - 1) if len(v) else np.empty(0, np.int64)
    return np.stack([v[new], t[new], t[last]], axis=1).astype(np.int64).reshape(-1, 3)


def _blocked_intervals(blocked: Blocked, path_vt: Ints, snapshot: Ints) -> Ints:
    """Return (B, 4): VT, vehicle, first and last snapshot of each time that a vehicle blocks a VT's path."""
    own = path_vt[blocked.path] >= 0
    path, vehicle = blocked.path[own], blocked.vehicle[own]
    pair, which = np.unique(np.stack([path_vt[path], vehicle], axis=1), axis=0, return_inverse=True)
    runs = visible_intervals(which.reshape(-1), snapshot[path])
    return np.concatenate([pair[runs[:, 0]], runs[:, 1:]], axis=1).reshape(-1, 4)
