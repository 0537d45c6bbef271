"""From a folder of tables and its manifest to a recording.

`TABLES` is the one description of columns: their names, and the units in which each may be given.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.recordings.importing.campaign import (
    DEVIATIONS,
    KINDS_OF_NOISE,
    NOTHING,
    QUANTITIES,
    Campaign,
    ReferenceTable,
    build,
)
from cellslam.recordings.importing.geodesy import projected
from cellslam.recordings.importing.manifest import (
    NAME,
    Column,
    DriveTable,
    Link,
    Manifest,
    Noise,
    ReferenceFile,
    Start,
    load_manifest,
)
from cellslam.recordings.importing.odometry import OdometryTable, times_of
from cellslam.recordings.importing.tables import TableFile
from cellslam.sim.described import POSE_COLUMNS, POSITION_COLUMNS
from cellslam.sim.errors import InputError, nearest_name, unknown_name
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, mean_velocity, rotation
from cellslam.sim.recording import CLOCK_PRIOR, COMPONENTS, Floats, Ints, Recording

Units = dict[str, float]  # what one of each is in ours, which comes first
TIME: Units = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH: Units = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
SAMPLES: Units = {"samples": np.nan}  # by [measurements] sample_rate_hz
DELAY: Units = LENGTH | {unit: SPEED_OF_LIGHT_MPS * factor for unit, factor in TIME.items()} | SAMPLES
ANGLE: Units = {"rad": 1.0, "deg": np.pi / 180.0}
RATE: Units = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
SPEED: Units = {"m/s": 1.0, "km/h": 1.0 / 3.6}
LEVEL: Units = {"dB": 1.0}

TABLES: dict[str, dict[str, Units]] = {
    "measurements": {
        "time_s": TIME,
        **dict(zip(QUANTITIES, (DELAY, ANGLE, ANGLE, LEVEL), strict=True)),
        **dict(zip(DEVIATIONS, (DELAY, ANGLE, ANGLE), strict=True)),
    },
    "snapshots": {"time_s": TIME},
    "odometry": {"time_s": TIME, **dict.fromkeys(COMPONENTS[:3], SPEED), **dict.fromkeys(COMPONENTS[3:], RATE)},
    "odometry of kind poses": {
        "time_s": TIME,
        **dict.fromkeys(POSITION_COLUMNS, LENGTH),
        **dict.fromkeys(POSE_COLUMNS[3:], ANGLE),
    },
    "reference": {
        "time_s": TIME,
        **dict.fromkeys(POSITION_COLUMNS, LENGTH),
        **dict.fromkeys(("latitude_rad", "longitude_rad", "yaw_rad"), ANGLE),
        "std_m": LENGTH,
    },
}
STDS = {"distance_m": "distance_std_m", "azimuth_deg": "azimuth_std_rad", "elevation_deg": "elevation_std_rad"}


@dataclass(frozen=True)
class Table:
    """A table of a campaign: its file, its times (N,) in s on the recording's clock, its other columns (N,) in m, rad,
    m/s, rad/s or dB.
    """

    file: TableFile
    time_s: Floats
    columns: dict[str, Floats]


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
    table = read_table(folder, manifest, "measurements")
    for name, std in manifest.measurements.std.items():
        if name not in STDS:
            raise unknown_name("key of measurements.std", name, STDS)
        table.columns[STDS[name]] = np.full(len(table.time_s), std if name == "distance_m" else np.radians(std))
    names, rows = _links(manifest, table)
    links = [manifest.links.get(name, Link(site=name)) for name in names]
    sites = [link.site for link in links]
    about: dict[str, Any] = {"description": manifest.description, "manifest": manifest.model_dump(mode="json")}
    odometry = reference = None
    if manifest.odometry is not None:
        odometry = _odometry(read_table(folder, manifest, "odometry"), manifest.odometry)
    if manifest.reference is not None:
        reference = _reference(read_table(folder, manifest, "reference"), manifest.reference, about)
    return Campaign(
        time_s=table.time_s,
        columns=table.columns,
        link=rows,
        link_sites=sites,
        link_cells=[link.cell_id for link in links],
        link_ports=[link.port for link in links],
        link_azimuths=[np.nan if link.azimuth_deg is None else np.radians(link.azimuth_deg) for link in links],
        site_offsets=_offsets(manifest, sites),
        site_surveys=_surveys(manifest),
        odometry=odometry,
        noise=_noise(manifest),
        start_pose=_start(manifest),
        start_std=_start_std(manifest.start),
        reference=reference,
        snapshots_s=None if manifest.snapshots is None else read_table(folder, manifest, "snapshots").time_s,
        plane=manifest.plane,
        range_scale_std=manifest.range_scale_std,
        scatterers=manifest.scatterers,
        about=about,
    )


def _links(manifest: Manifest, table: Table) -> tuple[list[str], Ints]:
    """Return the values of the link column, those of [links] first, and each row's index among them."""
    column = manifest.measurements.link
    if column is None:
        return list(manifest.links)[:1] or ["link"], np.zeros(len(table.time_s), np.int64)
    labels = table.file.labels(column.column)
    known = list(manifest.links) or sorted(set(labels), key=lambda name: (len(name), name))
    index = {name: i for i, name in enumerate(known)}
    for row, name in enumerate(labels):
        if name not in index:
            raise InputError(
                f"{table.file.path}: column '{column.column}', row {row}: link '{name}' is not in "
                f"[links]{nearest_name(name, known)}; add [links.{name}] or leave the row out"
            )
    return known, np.array([index[name] for name in labels], np.int64)


def _offsets(manifest: Manifest, sites: list[str]) -> dict[str, tuple[float, ...]]:
    for name in sites:
        if name not in manifest.sites:
            raise InputError(
                f"[sites.{name}] is missing: write it with clock_offset_std_m, the deviation of its unknown clock "
                "offset in metres (0: synchronised, or no clock at all)"
            )
    for name in manifest.sites:
        if name not in sites:
            raise InputError(f"[sites.{name}] is the site of no link{nearest_name(name, sites)}; remove it")
    return {name: tuple(getattr(site, column) for column in CLOCK_PRIOR) for name, site in manifest.sites.items()}


def _surveys(manifest: Manifest) -> dict[str, tuple[float, ...]]:
    for name, site in manifest.sites.items():
        if site.position_m is None and any(site.position_std_m):
            raise InputError(
                f"[sites.{name}]: position_std_m without position_m: write where the site stands, or neither"
            )
    return {
        name: (*site.position_m, *site.position_std_m)
        for name, site in manifest.sites.items()
        if site.position_m is not None
    }


def _odometry(table: Table, asked: DriveTable) -> OdometryTable:
    times, columns, hold = table.time_s, table.columns, asked.hold
    if asked.kind == "poses":
        columns, times, hold = _differences(columns, times_of("odometry", times)), times[1:], "before"
    if asked.axes == "forward-right-down":
        other_way = ("u_y", "u_z", "u_psi", "u_theta")
        columns = {name: -values if name in other_way else values for name, values in columns.items()}
    return OdometryTable(times, columns, hold, asked.valid_s, asked.lever_arm_m, asked.time_constant_s)


def _differences(columns: dict[str, Floats], times: Floats) -> dict[str, Floats]:
    """Return mean body velocities from poses in a frame of the odometry's own; what has no column does not move."""
    poses = np.column_stack([columns.get(name, np.zeros(len(times))) for name in POSE_COLUMNS])
    u = mean_velocity(poses[:-1], poses[1:], np.diff(times))
    given = [any(name in columns for name in ("x_m", "y_m"))] * 2 + [name in columns for name in POSE_COLUMNS[2:]]
    return {name: u[:, i] for i, name in enumerate(COMPONENTS) if given[i]}


def _noise(manifest: Manifest) -> dict[str, tuple[float, ...]]:
    for name in manifest.noise:
        if name not in COMPONENTS:
            raise unknown_name("component of [noise]", name, COMPONENTS)
    for name in manifest.odometry.columns if manifest.odometry is not None else ():
        if name in COMPONENTS and name not in manifest.noise:
            raise InputError(
                f"[noise.{name}] is missing: write its noise_density (m/s or rad/s times root second), bias, scale; "
                "'cellslam fit-noise' estimates them once the recording is made"
            )
    rows = [manifest.noise.get(component, Noise()) for component in COMPONENTS]
    return {kind: tuple(getattr(row, kind) for row in rows) for kind in KINDS_OF_NOISE}


def _start(manifest: Manifest) -> tuple[float, ...] | None:
    start = manifest.start
    if start.source == "reference" and manifest.reference is None:
        raise InputError("start.source = 'reference', but there is no [reference]: give the pose, or say 'origin'")
    given = (*start.position_m, *np.radians([start.yaw_deg, start.pitch_deg, start.roll_deg]).tolist())
    return {"reference": None, "origin": NOTHING, "given": given}[start.source]


def _start_std(start: Start) -> tuple[float, ...]:
    """Return the deviations (6,) of the start pose in m and rad, NaN where the file has none."""
    unknown = (np.nan,) * 3
    return *(start.std_m or unknown), *np.radians(start.std_deg or unknown).tolist()


def _reference(table: Table, asked: ReferenceFile, about: dict[str, Any]) -> ReferenceTable:
    """Return the reference; `about` receives how it was projected."""
    columns = table.columns
    height, yaw = columns.get("z_m", np.full(len(table.time_s), np.nan)), columns.get("yaw_rad")
    on_globe = "latitude_rad" in columns and "longitude_rad" in columns
    if on_globe:
        plane, crs, convergence = projected(columns["latitude_rad"], columns["longitude_rad"], asked.crs)
        first = plane[np.isfinite(plane).all(axis=1)][0] if asked.origin_m is None else np.asarray(asked.origin_m)
        plane = plane - first
        about["projection"] = {"crs": crs, "origin_m": first.tolist()}
        yaw = None if yaw is None else yaw + convergence
    elif "x_m" in columns and "y_m" in columns:
        plane = np.column_stack([columns["x_m"], columns["y_m"]])
    else:
        raise InputError("reference.columns: give x_m and y_m, or latitude_rad and longitude_rad")
    if asked.axes == "north-east-down":
        plane = plane if on_globe else plane[:, ::-1]
        height, yaw = -height, None if yaw is None else 0.5 * np.pi - yaw
    position = np.column_stack([plane, height])
    if any(asked.lever_arm_m):
        if yaw is None:
            raise InputError(
                "reference.lever_arm_m needs the column yaw_rad, to know where the array is; or leave it out"
            )
        position = position + np.einsum("nij,j->ni", rotation(yaw, 0.0 * yaw, 0.0 * yaw), np.asarray(asked.lever_arm_m))
    return ReferenceTable(table.time_s, position, yaw, columns.get("std_m", asked.std_m))


def read_table(folder: Path, manifest: Manifest, name: str) -> Table:
    """Return the table [name] of a manifest. Raises InputError naming column, unit, or row."""
    asked = getattr(manifest, name)
    described = TABLES["odometry of kind poses" if getattr(asked, "kind", "") == "poses" else name]
    for own, column in asked.columns.items():
        if own not in described:
            raise unknown_name(f"key of {name}.columns", own, described)
        if column.unit not in described[own]:
            allowed = ", ".join(described[own])
            raise InputError(f"{name}.columns.{own}: unit '{column.unit}' does not fit; give it in {allowed}")
    if "time_s" not in asked.columns:
        raise InputError(f"{name}.columns: 'time_s' is missing; name the column that holds the time")
    file, rate = TableFile(folder / asked.file, asked.variable, asked.delimiter), manifest.measurements.sample_rate_hz
    columns = {
        own: _in_our_unit(own, column, file.numbers(column.column), described[own], rate)
        for own, column in asked.columns.items()
    }
    return Table(file, _on_our_clock(columns.pop("time_s"), manifest, asked.clock), columns)


def _in_our_unit(name: str, column: Column, values: Floats, units: Units, sample_rate_hz: float | None) -> Floats:
    """Return a column (N,): (zero + sign * value) times the unit."""
    factor = units[column.unit]
    if column.unit in SAMPLES:
        if sample_rate_hz is None:
            raise InputError(f"measurements.columns.{name}: unit 'samples' needs measurements.sample_rate_hz")
        factor = SPEED_OF_LIGHT_MPS / sample_rate_hz
    # What needs no change keeps its last digit.
    if column.sign == 1 and column.zero == 0.0:
        return values if factor == 1.0 else values * factor
    return (column.zero + column.sign * values) * factor


def _on_our_clock(times: Floats, manifest: Manifest, name: str) -> Floats:
    """Return times (N,) in s of the clock `name`, empty for the recording's own, on the recording's."""
    if not name:
        return times
    if name not in manifest.clocks:
        near = nearest_name(name, manifest.clocks)
        raise InputError(f"clock '{name}' is not in [clocks]{near} (known: {', '.join(manifest.clocks) or 'none'})")
    clock = manifest.clocks[name]
    return clock.offset_s + (1.0 + 1e-6 * clock.drift_ppm) * times
