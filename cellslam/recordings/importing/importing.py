"""From a folder of tables and its manifest to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cellslam.recordings.importing.campaign import CLAIMS, QUANTITIES, Campaign, OdometryTable, ReferenceTable
from cellslam.recordings.importing.campaign_to_recording import build
from cellslam.recordings.importing.geodesy import projected
from cellslam.recordings.importing.manifest import (
    NAME,
    Clock,
    DriveTable,
    FileTable,
    Manifest,
    ReferenceFile,
    load_manifest,
)
from cellslam.recordings.importing.tables import TableFile
from cellslam.recordings.importing.units import in_ours, known_columns, on_clock
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.recording import CLOCK_PRIOR, COMPONENTS, Floats, Recording

POSES = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
REFERENCE = ("x_m", "y_m", "z_m", "latitude_rad", "longitude_rad", "yaw_rad", "std_m")
STDS = {"distance_m": "distance_std_m", "azimuth_deg": "azimuth_std_rad", "elevation_deg": "elevation_std_rad"}


def import_folder(folder: Path) -> Recording:
    """Return the recording that `recording.toml` in `folder` describes. Raises InputError naming file, column, row."""
    manifest = load_manifest(folder)
    try:
        return build(campaign_of(folder, manifest))
    except InputError as error:
        text = " ".join(str(error).split())  # a quoted cell may hold lines of its own
        raise InputError(text if text.startswith(str(folder)) else f"{folder / NAME}: {text}") from error


def campaign_of(folder: Path, manifest: Manifest) -> Campaign:
    """Return the tables of a folder in our units. Raises InputError."""
    table = manifest.measurements
    known_columns("measurements", table.columns, ("time_s", *QUANTITIES, *CLAIMS))
    file = TableFile(folder, table)
    columns = {
        name: in_ours(name, column, file.numbers(column.column), table.sample_rate_hz)
        for name, column in table.columns.items()
    }
    times = on_clock(columns.pop("time_s"), _clock(manifest, table))
    for name, std in table.std.items():
        if name not in STDS:
            raise InputError(f"measurements.std: unknown '{name}'{nearest_name(name, STDS)} (known: {', '.join(STDS)})")
        columns[STDS[name]] = np.full(len(times), std if name == "distance_m" else np.radians(std))
    names, link = _links(manifest, file, len(times))
    links = [manifest.links.get(name) for name in names]
    sites = [name if known is None else known.site for name, known in zip(names, links, strict=True)]
    about: dict[str, Any] = {"description": manifest.description, "manifest": manifest.model_dump(mode="json")}
    reference = None if manifest.reference is None else _reference(folder, manifest, manifest.reference, about)
    return Campaign(
        time_s=times,
        columns=columns,
        link=link,
        link_sites=sites,
        link_cells=[-1 if known is None else known.cell_id for known in links],
        link_ports=[-1 if known is None else known.port for known in links],
        site_offsets=_offsets(manifest, sites),
        odometry=None if manifest.odometry is None else _odometry(folder, manifest, manifest.odometry),
        noise=_noise(manifest),
        start_pose=_start(manifest),
        start_std=(*manifest.start.std_m, *np.radians(manifest.start.std_deg)),
        reference=reference,
        snapshots_s=_snapshots(folder, manifest),
        plane=manifest.plane,
        about=about,
    )


def _links(manifest: Manifest, file: TableFile, rows: int) -> tuple[list[str], Any]:
    """Return the values of the link column, those of [links] first, and each row's index among them."""
    column = manifest.measurements.link
    if column is None:
        return list(manifest.links)[:1] or ["link"], np.zeros(rows, np.int64)
    labels = file.labels(column.column)
    seen = list(dict.fromkeys(labels))
    known = list(manifest.links) or sorted(seen, key=lambda name: (len(name), name))
    unknown = set(seen) - set(known)
    if unknown:
        row = next(i for i, name in enumerate(labels) if name in unknown)
        near = nearest_name(labels[row], known)
        raise InputError(
            f"{file.path}: column '{column.column}', row {row}: link '{labels[row]}' is not in [links]{near}; "
            f"add [links.{labels[row]}] or leave the row out"
        )
    index = {name: i for i, name in enumerate(known)}
    return known, np.array([index[name] for name in labels], np.int64)


def _offsets(manifest: Manifest, sites: list[str]) -> dict[str, tuple[float, ...]]:
    for name in dict.fromkeys(sites):
        if name not in manifest.sites:
            raise InputError(
                f"[sites.{name}] is missing: write it with clock_offset_std_m, the deviation of its unknown "
                f"clock offset "
                "in metres (0: synchronised, or no clock at all)"
            )
    for name in manifest.sites:
        if name not in sites:
            raise InputError(f"[sites.{name}] is the site of no link{nearest_name(name, sites)}; remove it")
    return {name: tuple(getattr(site, column) for column in CLOCK_PRIOR) for name, site in manifest.sites.items()}


def _clock(manifest: Manifest, table: FileTable) -> Clock:
    if not table.clock:
        return Clock()
    if table.clock not in manifest.clocks:
        near = nearest_name(table.clock, manifest.clocks)
        raise InputError(
            f"clock '{table.clock}' is not in [clocks]{near} (known: {', '.join(manifest.clocks) or 'none'})"
        )
    return manifest.clocks[table.clock]


def _snapshots(folder: Path, manifest: Manifest) -> Floats | None:
    table = manifest.snapshots
    if table is None:
        return None
    known_columns("snapshots", table.columns, ("time_s",))
    column = table.columns["time_s"]
    return on_clock(in_ours("time_s", column, TableFile(folder, table).numbers(column.column)), _clock(manifest, table))


def _odometry(folder: Path, manifest: Manifest, table: DriveTable) -> OdometryTable:
    known = ("time_s", *(COMPONENTS if table.kind == "velocities" else POSES))
    known_columns("odometry", table.columns, known)
    file = TableFile(folder, table)
    columns = {name: in_ours(name, column, file.numbers(column.column)) for name, column in table.columns.items()}
    times = on_clock(columns.pop("time_s"), _clock(manifest, table))
    hold = table.hold
    if table.kind == "poses":
        late = np.flatnonzero(~(np.diff(times) > 0))
        if len(late):
            raise InputError(
                f"{file.path}: row {late[0] + 1}: its time is not after that of the row before it: sort by time"
            )
        columns, times, hold = _differences(columns, times), times[1:], "before"
    if table.axes == "forward-right-down":
        columns = {
            name: -values if name in ("u_y", "u_z", "u_psi", "u_theta") else values for name, values in columns.items()
        }
    return OdometryTable(times, columns, hold, table.lever_arm_m)


def _differences(columns: dict[str, Floats], times: Floats) -> dict[str, Floats]:
    """Return mean body velocities from poses in a frame of the odometry's own; what has no column does not move."""
    poses = np.column_stack([columns.get(name, np.zeros(len(times))) for name in POSES])
    u = mean_velocity(poses[:-1], poses[1:], np.diff(times))
    given = [any(name in columns for name in ("x_m", "y_m"))] * 2 + [name in columns for name in POSES[2:]]
    return {name: u[:, i] for i, name in enumerate(COMPONENTS) if given[i]}


def _noise(manifest: Manifest) -> dict[str, tuple[float, ...]]:
    for name in manifest.noise:
        if name not in COMPONENTS:
            raise InputError(
                f"[noise.{name}]: unknown{nearest_name(name, COMPONENTS)} (known: {', '.join(COMPONENTS)})"
            )
    table = manifest.odometry
    if table is not None and table.kind == "velocities":
        for name in table.columns:
            if name in COMPONENTS and name not in manifest.noise:
                raise InputError(
                    f"[noise.{name}] is missing: write its noise_density (m/s or rad/s times root second), "
                    f"bias, scale; "
                    "'cellslam fit-noise' estimates them once the recording is made"
                )
    kinds = ("noise_density", "bias", "bias_walk_density", "scale")
    rows = [manifest.noise.get(component) for component in COMPONENTS]
    return {kind: tuple(0.0 if row is None else float(getattr(row, kind)) for row in rows) for kind in kinds}


def _start(manifest: Manifest) -> tuple[float, ...] | None:
    start = manifest.start
    if start.source == "reference":
        if manifest.reference is None:
            raise InputError("start.source = 'reference', but there is no [reference]: give the pose, or say 'origin'")
        return None
    if start.source == "origin":
        return (0.0,) * 6
    return (*start.position_m, *np.radians([start.yaw_deg, start.pitch_deg, start.roll_deg]).tolist())


def _reference(folder: Path, manifest: Manifest, table: ReferenceFile, about: dict[str, Any]) -> ReferenceTable:
    """Return the reference; `about` is told how it was projected."""
    known_columns("reference", table.columns, ("time_s", *REFERENCE))
    file = TableFile(folder, table)
    columns = {name: in_ours(name, column, file.numbers(column.column)) for name, column in table.columns.items()}
    times = on_clock(columns.pop("time_s"), _clock(manifest, table))
    if "latitude_rad" in columns and "longitude_rad" in columns:
        plane, crs, convergence = projected(columns["latitude_rad"], columns["longitude_rad"], table.crs)
        first = plane[np.isfinite(plane).all(axis=1)][0] if table.origin_m is None else np.asarray(table.origin_m)
        plane = plane - first
        about["projection"] = {"crs": crs, "origin_m": first.tolist()}
        if "yaw_rad" in columns:
            columns["yaw_rad"] = columns["yaw_rad"] + convergence
    elif "x_m" in columns and "y_m" in columns:
        plane = np.column_stack([columns["x_m"], columns["y_m"]])
    else:
        raise InputError("reference.columns: give x_m and y_m, or latitude_rad and longitude_rad")
    height = columns.get("z_m", np.full(len(times), np.nan))
    yaw = columns.get("yaw_rad")
    if table.axes == "north-east-down":
        plane = plane if "latitude_rad" in columns else plane[:, ::-1]
        height, yaw = -height, None if yaw is None else 0.5 * np.pi - yaw
    position = np.column_stack([plane, height])
    if any(table.lever_arm_m):
        if yaw is None:
            raise InputError(
                "reference.lever_arm_m needs the column yaw_rad, to know where the array is; or leave it out"
            )
        position = position + np.einsum("nij,j->ni", rotation(yaw, 0.0 * yaw, 0.0 * yaw), np.asarray(table.lever_arm_m))
    return ReferenceTable(times, position, yaw, columns.get("std_m", table.std_m))
