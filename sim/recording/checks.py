"""What a recording must fulfil: the first breach is named by table, column and row, with what to do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.recording.tables import (
    CLOCK_PRIOR,
    Floats,
    Ints,
    Measurements,
    RecordingData,
    Reference,
    Truth,
    Vehicles,
)

MEASURED = ("distance_m", "azimuth_rad", "elevation_rad")
CLAIMED = ("distance_std_m", "azimuth_std_rad", "elevation_std_rad")


def check(recording: RecordingData) -> None:
    """Raise InputError, naming table, column and row, where a recording breaks the contract."""
    r = recording
    count = len(r.time_s)
    _shape("time_s", r.time_s, (count,))
    if count == 0:
        raise InputError("time_s is empty: a recording needs at least one snapshot")
    _finite("time_s", r.time_s)
    _require(np.diff(r.time_s) > 0, "time_s", "is not after the row before it: sort the snapshots by time", offset=1)
    _check_odometry(r, count)
    _check_links(r)
    _check_measurements(r.measurements, count, len(r.links))
    if r.truth is not None:
        _check_truth(r.truth, r)
    if r.reference is not None:
        _check_reference(r.reference)
    if r.plane and not np.isnan(r.measurements.elevation_rad).all():
        raise InputError("plane is set, but measurements.elevation_rad has values: leave one of both out")


def _check_odometry(r: RecordingData, count: int) -> None:
    _shape("odometry", r.odometry, (count, 6))
    _require(~np.isinf(r.odometry), "odometry", "is infinite: write NaN where a component was not measured")
    _shape("start_pose", r.start_pose, (6,))
    _shape("start_std", r.start_std, (6,))
    _finite("start_pose", r.start_pose)
    _require(r.start_std >= 0, "start_std", "is not a standard deviation (must be >= 0)")
    for name in ("noise_density", "bias", "bias_walk_density", "scale"):
        column = getattr(r.odometry_model, name)
        _shape(f"odometry_model.{name}", column, (6,))
        _require(column >= 0, f"odometry_model.{name}", "is not a standard deviation (must be >= 0)")
        _finite(f"odometry_model.{name}", column)


def _check_links(r: RecordingData) -> None:
    for name in ("site", "cell_id", "port"):
        _shape(f"links.{name}", getattr(r.links, name), (len(r.links),))
    for name in CLOCK_PRIOR:
        column = getattr(r.sites, name)
        if column is not None:
            _shape(f"sites.{name}", column, (len(r.sites),))
            if name != "clock_offset_mean_m":
                _require(column >= 0, f"sites.{name}", "is negative")
            _finite(f"sites.{name}", column)
    if r.sites.position_m is not None:
        _shape("sites.position_m", r.sites.position_m, (len(r.sites), 3))
    _require(
        (r.links.site >= 0) & (r.links.site < len(r.sites)), "links.site", f"is not one of the {len(r.sites)} sites"
    )


def _check_measurements(m: Measurements, snapshots: int, links: int) -> None:
    for name in ("link", *MEASURED, "snr_db"):
        _shape(f"measurements.{name}", getattr(m, name), (len(m),))
    _require(
        (m.snapshot >= 0) & (m.snapshot < snapshots),
        "measurements.snapshot",
        f"is not one of the {snapshots} snapshots",
    )
    _require((m.link >= 0) & (m.link < links), "measurements.link", f"is not one of the {links} links")
    key = m.snapshot * max(links, 1) + m.link
    _require(np.diff(key) >= 0, "measurements", "is not sorted by (snapshot, link)", offset=1)
    for name in (*MEASURED, "snr_db"):
        _require(
            ~np.isinf(getattr(m, name)), f"measurements.{name}", "is infinite: write NaN where it was not measured"
        )
    _require(
        ~(np.abs(m.azimuth_rad) > np.pi + 1e-9),
        "measurements.azimuth_rad",
        "is outside [-pi, pi]: radians are expected; are these degrees?",
    )
    _require(
        ~(np.abs(m.elevation_rad) > np.pi / 2 + 1e-9),
        "measurements.elevation_rad",
        "is outside [-pi/2, pi/2]: radians are expected; are these degrees?",
    )
    nothing = np.isnan(m.distance_m) & np.isnan(m.azimuth_rad) & np.isnan(m.elevation_rad)
    _require(~nothing, "measurements", "measures neither distance nor angle: leave the row out")
    for name in CLAIMED:
        column = getattr(m, name)
        if column is not None:
            _shape(f"measurements.{name}", column, (len(m),))
            _require(~(column <= 0), f"measurements.{name}", "is not a standard deviation (must be > 0)")
    row = _repeated(m, key)
    if row is not None:
        raise InputError(
            f"measurements, row {row}: repeats an earlier row of its snapshot and link; remove one of them"
        )


def _repeated(m: Measurements, key: Ints) -> int | None:
    """Return the first row that equals an earlier one in snapshot, link, distance, angles and SNR."""
    code = key.astype(np.uint64)
    for name in (*MEASURED, "snr_db"):
        bits = np.ascontiguousarray(getattr(m, name)).view(np.uint64)
        code = (code ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        code ^= code >> np.uint64(29)
    order = np.argsort(code, kind="stable")
    same = np.flatnonzero(code[order[1:]] == code[order[:-1]])
    rows = [
        np.array([getattr(m, n)[order[i]] for n in ("snapshot", "link", *MEASURED, "snr_db")]) for i in (same, same + 1)
    ]
    equal = (rows[0] == rows[1]) | (np.isnan(rows[0]) & np.isnan(rows[1]))
    repeats = order[1:][same[equal.all(axis=0)]]
    return int(repeats.min()) if len(repeats) else None


def _check_truth(truth: Truth, r: RecordingData) -> None:
    vts = len(truth.vts)
    _shape("truth.poses", truth.poses, (len(r.time_s), 6))
    _finite("truth.poses", truth.poses)
    _shape("truth.measurement_vt", truth.measurement_vt, (len(r.measurements),))
    _shape("truth.measurement_std", truth.measurement_std, (len(r.measurements), 3))
    for name in ("persisting_std", "merging_shift"):
        if (column := getattr(truth, name)) is not None:
            _shape(f"truth.{name}", column, (len(r.measurements), 3))
    _shape("truth.vts.position_m", truth.vts.position_m, (vts, 3))
    _shape("truth.site_positions_m", truth.site_positions_m, (len(r.sites), 3))
    _shape("truth.clock_offsets_m", truth.clock_offsets_m, (len(r.sites),))
    if truth.clock_drift_m_s is not None:
        _shape("truth.clock_drift_m_s", truth.clock_drift_m_s, (len(r.sites),))
    if truth.clock_wander_m is not None:
        _shape("truth.clock_wander_m", truth.clock_wander_m, (len(r.time_s), len(r.sites)))
        _finite("truth.clock_wander_m", truth.clock_wander_m)
    for name in ("odometry_slip", "age_s"):
        column = getattr(truth, name)
        if column is not None:
            _shape(f"truth.{name}", column, (len(r.time_s),))
    if truth.clock_steps is not None:
        steps = truth.clock_steps
        _require(
            (steps.site >= 0) & (steps.site < len(r.sites)), "truth.clock_steps.site",
            f"is not one of the {len(r.sites)} sites",
        )  # fmt: skip
    _require(
        (truth.measurement_vt >= -1) & (truth.measurement_vt < vts),
        "truth.measurement_vt",
        f"is not one of the {vts} VTs",
    )
    if truth.vehicles is not None:
        _check_vehicles(truth.vehicles, vts, len(r.time_s), len(r.measurements))


def _check_vehicles(v: Vehicles, vts: int, snapshots: int, measurements: int) -> None:
    _shape("truth.vehicles.size_m", v.size_m, (len(v), 3))
    _require(v.size_m > 0, "truth.vehicles.size_m", "is not a size (must be > 0)")
    _shape("truth.vehicles.time_s", v.time_s, (len(v.time_s),))
    _require(np.diff(v.time_s) > 0, "truth.vehicles.time_s", "is not after the row before it: sort by time", offset=1)
    _shape("truth.vehicles.poses", v.poses, (len(v.time_s), len(v), 4))
    _finite("truth.vehicles.poses", v.poses)
    _shape("truth.vehicles.blocked", v.blocked, (len(v.blocked), 4))
    for column, (what, count) in enumerate((("VTs", vts), ("vehicles", len(v)), *2 * (("snapshots", snapshots),))):
        own = v.blocked[:, column]
        _require((own >= 0) & (own < count), "truth.vehicles.blocked", f"is not one of the {count} {what}")
    _shape("truth.vehicles.reflected", v.reflected, (measurements,))
    reflected = (v.reflected >= -1) & (v.reflected < len(v))
    _require(reflected, "truth.vehicles.reflected", f"is not one of the {len(v)} vehicles")


def _check_reference(reference: Reference) -> None:
    count = len(reference)
    _shape("reference.position_m", reference.position_m, (count, 3))
    _shape("reference.yaw_rad", reference.yaw_rad, (count,))
    _shape("reference.position_std_m", reference.position_std_m, (count,))
    if count == 0:
        raise InputError("reference.time_s is empty: leave the table 'reference' out where there is none")
    _finite("reference.time_s", reference.time_s)
    _require(
        np.diff(reference.time_s) > 0, "reference.time_s", "is not after the row before it: sort by time", offset=1
    )
    for name in ("position_m", "yaw_rad"):
        _require(~np.isinf(getattr(reference, name)), f"reference.{name}", "is infinite: write NaN where it is unknown")
    _require(~(reference.position_std_m < 0), "reference.position_std_m", "is negative")


def _shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, expected {shape}")


def _finite(name: str, array: Floats) -> None:
    _require(np.isfinite(array), name, "is not finite: leave the row out, or write the number")


def _require(ok: NDArray[np.bool_], name: str, problem: str, offset: int = 0) -> None:
    if not ok.all():
        row = int(np.argmin(ok.reshape(len(ok), -1).all(axis=1))) + offset
        raise InputError(f"{name}, row {row}: {problem}")
