"""A recording as CSV tables or one MATLAB file, with the `recording.toml` that `cellslam import` reads them back by."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.array_calibration import field_map
from cellslam.benchmarks.trials.output_files import at_once
from cellslam.recordings.importing.campaign import DEVIATIONS, KINDS_OF_NOISE, QUANTITIES
from cellslam.recordings.importing.importing import TABLES
from cellslam.recordings.importing.manifest import NAME
from cellslam.sim.described import POSE_COLUMNS, POSITION_COLUMNS
from cellslam.sim.errors import InputError
from cellslam.sim.recording import CLOCK_PRIOR, COMPONENTS, Recording
from cellslam.slam.model.calibration import COMPONENTS as CALIBRATED
from cellslam.slam.model.calibration import Calibration

# What is written is in our units, those that stand first.
UNITS = {name: next(iter(units)) for columns in TABLES.values() for name, units in columns.items()}
Tables = dict[str, dict[str, Any]]


def write_tables(recording: Recording, folder: Path, kind: str) -> None:
    """Write tables and `recording.toml` into a new folder, at once. Raises InputError.

    `kind`: csv, one file a table, or mat, `recording.mat` (version 5: one struct a table, columns).
    """
    import pandas as pd
    from scipy.io import savemat

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--out {folder}: exists already; give the name of a new folder")
    if not folder.absolute().parent.is_dir():
        raise InputError(f"--out {folder}: there is no folder {folder.parent}; create it first")
    imported = tables(recording)
    every = imported | _truth_tables(recording)
    with at_once(folder) as place:
        place.mkdir()
        if kind == "csv":
            for name, columns in every.items():
                pd.DataFrame(columns).to_csv(place / f"{name}.csv", index=False)
            sources = {name: {"file": f"{name}.csv"} for name in imported}
        else:
            savemat(place / "recording.mat", every, oned_as="column", long_field_names=True)
            sources = {name: {"file": "recording.mat", "variable": name} for name in imported}
        _write_manifest(recording, imported, place, sources)


def tables(recording: Recording) -> Tables:
    """Return the tables that are imported again, by name and column; what was not measured has no column."""
    r, m = recording, recording.measurements
    paths = {name: getattr(m, name) for name in (*QUANTITIES, *DEVIATIONS)}
    out: Tables = {
        "measurements": {"time_s": r.time_s[m.snapshot], "link": m.link, **_known(paths)},
        "snapshots": {"time_s": r.time_s},
    }
    if odometry := _known(dict(zip(COMPONENTS, r.odometry.T, strict=True))):
        out["odometry"] = {"time_s": r.time_s, **odometry}
    if r.truth is not None:
        out["reference"] = {"time_s": r.time_s, **dict(zip(POSE_COLUMNS[:4], r.truth.poses.T, strict=False))}
    elif r.reference is not None:
        x, y, z = r.reference.position_m.T
        more = {"z_m": z, "yaw_rad": r.reference.yaw_rad, "std_m": r.reference.position_std_m}
        out["reference"] = {"time_s": r.reference.time_s, "x_m": x, "y_m": y, **_known(more)}
    return out


def _truth_tables(r: Recording) -> Tables:
    """Return what only a simulation knows, for other people's tools: it is not imported again."""
    if r.truth is None:
        return {}
    t = r.truth
    sites, vts = (dict(zip(POSITION_COLUMNS, p.T, strict=True)) for p in (t.site_positions_m, t.vts.position_m))
    sites |= {"clock_offset_m": t.clock_offsets_m} | _known({"clock_drift_m_s": t.clock_drift_m_s})
    return {
        "truth_poses": {"time_s": r.time_s, **dict(zip(POSE_COLUMNS, t.poses.T, strict=True))},
        "truth_measurements": {"vt": t.measurement_vt},
        "truth_sites": sites,
        "truth_vts": {"site": t.vts.site, "order": t.vts.order, **vts, **_known({"scatterer": t.vts.scatterer})},
    }


def _known(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns that there are, and that were measured at all."""
    there = {name: column for name, column in columns.items() if column is not None}
    return {name: column for name, column in there.items() if not (len(column) and np.isnan(column).all())}


def _write_manifest(recording: Recording, made: Tables, place: Path, sources: Mapping[str, Mapping[str, str]]) -> None:
    import tomli_w

    r, sites = recording, recording.sites

    def table(name: str, **more: Any) -> dict[str, Any]:
        columns = {c: {"column": c, "unit": UNITS[c]} for c in made[name] if c in UNITS}
        return {**sources[name], **more, "columns": columns}

    text: dict[str, Any] = {
        "description": str(r.provenance.get("description") or "exported by cellslam"),
        "plane": r.plane,
        "range_scale_std": float(r.range_scale_std),
        "scatterers": r.scatterers,
        "measurements": table("measurements", link={"column": "link"}),
        "snapshots": table("snapshots"),
        "start": {
            "source": "given",
            "position_m": r.start_pose[:3].tolist(),
            **dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), np.degrees(r.start_pose[3:]).tolist(), strict=True)),
            "std_m": r.start_std[:3].tolist(),
            "std_deg": np.degrees(r.start_std[3:]).tolist(),
        },
        "links": {
            str(i): {"site": sites.name[site], "cell_id": int(r.links.cell_id[i]), "port": int(r.links.port[i])}
            for i, site in enumerate(r.links.site)
        },
        "sites": {
            name: {c: float(getattr(sites, c)[i]) for c in CLOCK_PRIOR if getattr(sites, c) is not None}
            for i, name in enumerate(sites.name)
        },
        "noise": {
            name: {kind: float(getattr(r.odometry_model, kind)[i]) for kind in KINDS_OF_NOISE}
            for i, name in enumerate(COMPONENTS)
        },
    }
    for name, position_m, std_m in zip(sites.name, sites.surveyed_m, sites.survey_std_m, strict=True):
        if np.isfinite(position_m).all():
            text["sites"][name] |= {"position_m": position_m.tolist(), "position_std_m": std_m.tolist()}
    for i, azimuth in enumerate([] if r.links.azimuth_rad is None else np.degrees(r.links.azimuth_rad).tolist()):
        if np.isfinite(azimuth):
            text["links"][str(i)]["azimuth_deg"] = azimuth
    if "odometry" in made:
        text["odometry"] = table("odometry", hold="before")
        if r.odometry_model.time_constant_s is not None:
            text["odometry"]["time_constant_s"] = float(r.odometry_model.time_constant_s)
    if "reference" in made:
        text["reference"] = table("reference")
    (place / NAME).write_text(tomli_w.dumps(text), "utf-8")


def write_calibration(calibration: Calibration, provenance: Mapping[str, Any], file: Path) -> None:
    """Write an array's calibration as a CSV table: a row for each direction that was met.

    Azimuth and elevation in degrees, in the body frame; of each component the error's mean, its deviation and, where
    it is known, the truth, in m or degrees.
    """
    import pandas as pd

    field = field_map(calibration, provenance)
    azimuth, elevation = np.meshgrid(np.degrees(field.azimuth_rad), np.degrees(field.elevation_rad))
    met = np.isfinite(field.mean[..., 0])
    columns = {"azimuth_deg": azimuth[met], "elevation_deg": elevation[met]}
    for name in calibration.components:
        c = CALIBRATED.index(name)
        factor, unit = (1.0, "m") if name == "distance" else (180.0 / np.pi, "deg")
        parts = {"mean": field.mean, "std": field.std} | ({} if field.truth is None else {"truth": field.truth})
        columns |= {f"{name}_error_{part}_{unit}": factor * values[met][:, c] for part, values in parts.items()}
    pd.DataFrame(columns).to_csv(file, index=False, float_format="%.6g")
