"""Adapter for the vehicle campaigns of TU Ilmenau, Fyoris and Elowen: 2.53 GHz, 20 MHz, stacked circular arrays.

Files as `tui_files.py` says; what they leave open stands in `tui.toml` beside them. Measurements are either the paths
the authors have estimated (`Results_*.h5`) or those that our own estimator finds in the frequency responses. Neither
has odometry: there is none, or it is SIMULATED from the location with noise of a fixed seed, as the description then
says. Source: G. Sommerkorn, C. Schneider, M. Doebereiner and W. Kotterman, Fyoris, doi:10.71758/refodat.61; S. Semper,
G. Sommerkorn, M. Doebereiner and R. Thomae, Elowen, doi:10.71758/refodat.55; both CC BY 4.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cellslam.recordings.adapters.shared import simulated_odometry
from cellslam.recordings.adapters.tui_files import Angle, Container, Estimated, Location, Sheet, load_sheet, opened
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.geodesy import projected
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle
from cellslam.sim.recording import Floats, Ints

NOISE = (0.05, 0.05, 0.0, np.radians(0.5), 0.0, 0.0)  # of the simulated odometry, m/s and rad/s times root second


def load(folder: Path) -> Campaign:
    """Return the campaign of the files that `tui.toml` in `folder` names. Raises InputError."""
    sheet = load_sheet(folder)
    if sheet.responses is not None:
        from cellslam.recordings.adapters.tui_responses import estimated

        snapshots, times, link, columns = estimated(folder, sheet, sheet.responses)
        names = [f"port {port}" for port in sheet.responses.tx_ports]
    else:
        assert sheet.paths is not None
        snapshots, times, columns = _given(folder, sheet, sheet.paths)
        link, names = np.zeros(len(times), np.int64), ["transmitter"]
    about: dict[str, Any] = {"campaign": "TU Ilmenau", "sheet": sheet.model_dump(mode="json")}
    reference = None if sheet.location is None else _reference(folder, sheet, sheet.location, about)
    motion = None
    if sheet.odometry == "simulated" and reference is not None and reference.yaw_rad is not None:
        moving = (*np.asarray(reference.position_m).T[:2], np.unwrap(np.asarray(reference.yaw_rad, np.float64)))
        x, y, yaw = (np.interp(snapshots, np.asarray(reference.time_s), column) for column in moving)
        motion = simulated_odometry(snapshots, np.column_stack([x, y]), yaw, NOISE)
    about["description"] = folder.name + ("; odometry simulated from the location" if motion is not None else "")
    surveys: dict[str, Any] = {}
    if sheet.transmitter is not None:
        with opened(folder / sheet.transmitter.file, sheet.units) as file:
            surveys["transmitter"] = _places(file, "", about)[0].mean(axis=0).tolist()
    return Campaign(
        time_s=times,
        columns=columns,
        snapshots_s=snapshots,
        link=link,
        link_sites=["transmitter"] * len(names),
        link_ports=list(range(len(names))) if sheet.responses is not None else None,
        site_offsets={"transmitter": (0.0, sheet.clock_offset_std_m)},
        site_surveys=surveys,
        odometry=motion,
        noise={"noise_density": NOISE} if motion is not None else {},
        start_pose=(0.0,) * 6 if reference is None else None,
        reference=reference,
        plane=sheet.plane,
        range_scale_std=0.0,  # a sounder counts samples of one clock
        about=about,
    )


def _given(folder: Path, sheet: Sheet, asked: Estimated) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Return times of snapshots (T,) and of paths (M,) in s, and the columns (M,) of the authors' own estimates."""
    wanted = {"azimuth_rad": asked.azimuth, "elevation_rad": asked.elevation}
    with opened(folder / asked.file, sheet.units) as file:
        times = file.values("Results/MetaData/Snapshot/TimeStamp")
        delay, counts = _nested(file, f"Results/{asked.delay}", len(times))
        columns = {"distance_m": SPEED_OF_LIGHT_MPS * delay}
        for name, angle in wanted.items():
            if angle is not None:
                values, own = _nested(file, f"Results/{angle.dataset}", len(times))
                if not np.array_equal(own, counts):
                    row = int(np.flatnonzero(own != counts)[0])
                    raise InputError(
                        f"{file.path}: snapshot {row} has {counts[row]} delays and {own[row]} of '{angle.dataset}'"
                    )
                columns[name] = _ours(values, angle)
    return times, np.repeat(times, counts), columns


def _nested(file: Container, place: str, count: int) -> tuple[Floats, Ints]:
    """Return the values of all snapshots, one after the other, and how many each has (T,)."""
    rows = [np.ravel(np.asarray(row, np.float64)) for row in file.dataset(place)[()]]
    if len(rows) != count:
        raise InputError(f"{file.path}: {place} has {len(rows)} snapshots, its time stamps {count}")
    return file.factor(place) * np.concatenate(rows), np.array([len(row) for row in rows], np.int64)


def _ours(values: Floats, angle: Angle) -> Floats:
    turned = np.radians(angle.zero_deg) + angle.sign * values
    return wrap_angle(turned)


def _reference(folder: Path, sheet: Sheet, asked: Location, about: dict[str, Any]) -> ReferenceTable:
    """Return the positions of the location file; `about` receives how they were projected."""
    group = "PoseData"
    with opened(folder / asked.file, sheet.units) as file:
        times = file.values(f"{group}/MetaData/Snapshot/TimeStamp")
        yaw = None if asked.yaw is None else _ours(file.values(f"{group}/{asked.yaw.dataset}"), asked.yaw)
        place, convergence = _places(file, asked.crs, about)
        yaw = None if yaw is None else wrap_angle(yaw + convergence)
    return ReferenceTable(times, place, yaw, asked.std_m)


def _places(file: Container, crs: str, about: dict[str, Any]) -> tuple[Floats, Floats]:
    """Return the places (N, 3) in m of a location file, and what to add to its yaws, in rad.

    The first file sets the projection, which `about` receives; the others follow it.
    """
    group = "PoseData"
    if f"{group}/PosX" in file.file:
        return np.column_stack([file.values(f"{group}/Pos{axis}") for axis in "XYZ"]), np.zeros(1)
    latitude, longitude = (file.values(f"{group}/{name}") for name in ("Latitude", "Longitude"))
    plane, used, convergence = projected(latitude, longitude, about.get("projection", {"crs": crs})["crs"])
    about.setdefault("projection", {"crs": used, "origin_m": plane[0].tolist()})
    plane = plane - about["projection"]["origin_m"]
    return np.column_stack([plane, file.values(f"{group}/Height")]), convergence
