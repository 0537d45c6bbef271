"""Adapter for the 60 GHz campaign of Tampere University: 45 surveyed places with path ranges and angles of arrival.

File `Kampusareena_slam_measurements_svd_p999.mat` (also in a folder `measurements`): struct `sim` with `rx` and `tx`,
each (3, T): x, y in m and heading in rad of receiver and transmitter; cell `y` of (3, m) a place: range in m, angle of
departure, angle of arrival in rad, both counter-clockwise from the heading; cell `power` of (1, m) in dB. Source:
O. Kaltiokallio et al., Robust snapshot radio SLAM, IEEE Transactions on Vehicular Technology, 2024, and the files that
come with it.

The campaign has no clock and no odometry. Places are taken a second apart, and the odometry is SIMULATED from the
surveyed poses with the noise stated below (fixed seed); the recording's description says so.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.recordings.adapters.shared import is_known, simulated_odometry
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats

NAME = "Kampusareena_slam_measurements_svd_p999.mat"
INTERVAL_S = 1.0
DISTANCE_STD_M, AZIMUTH_STD_RAD = 0.3, np.radians(3.0)  # a nanosecond and three degrees, as the authors assume
NOISE = (0.05, 0.05, 0.0, np.radians(2.0), 0.0, 0.0)  # of the simulated odometry, m/s and rad/s times root second


def load(folder: Path, *, sites: str = "unknown") -> Campaign:
    """Return the campaign of the file in `folder` (or the file itself). Raises InputError naming what does not fit.

    `sites`: "known", position and heading of the transmitter are known, those of sim.tx at the first place.
    """
    surveyed = is_known("sites", sites)
    places = [folder] if folder.is_file() else [folder / NAME, folder / "measurements" / NAME]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise InputError(f"{folder}: holds no {NAME}; download it into this folder")
    sim = variables(path, ("sim",))["sim"]
    for name in ("rx", "tx", "y"):
        if not isinstance(sim, dict) or name not in sim:
            raise InputError(f"{path}: the struct 'sim' has no field '{name}'")
    rx = np.asarray(sim["rx"], np.float64)
    cells = [np.atleast_2d(np.asarray(cell, np.float64)) for cell in sim["y"]]
    if rx.ndim != 2 or rx.shape[0] < 3 or rx.shape[1] != len(cells):
        count = len(cells)
        raise InputError(f"{path}: sim.rx has shape {rx.shape}, expected (3, {count}) as sim.y has {count} cells")
    tx = np.asarray(sim["tx"], np.float64)
    tx = tx[:, 0] if tx.ndim == 2 else tx
    for index, cell in enumerate(cells):
        if cell.size and cell.shape[0] != 3:
            raise InputError(
                f"{path}: sim.y, cell {index} has shape {cell.shape}, expected (3, paths): range, departure, arrival"
            )
    times = INTERVAL_S * np.arange(len(cells), dtype=np.float64)
    paths = [cell if cell.size else np.empty((3, 0)) for cell in cells]
    distance, _, arrival = np.concatenate(paths, axis=1)
    rows = np.repeat(times, [cell.shape[1] for cell in paths])
    yaw: Floats = wrap_angle(rx[2])
    return Campaign(
        time_s=rows,
        columns={
            "distance_m": distance,
            "azimuth_rad": wrap_angle(arrival),
            "distance_std_m": np.full(len(rows), DISTANCE_STD_M),
            "azimuth_std_rad": np.full(len(rows), AZIMUTH_STD_RAD),
        },
        snapshots_s=times,
        odometry=simulated_odometry(times, rx[:2].T, yaw, NOISE),
        link_sites=("transmitter",),
        link_azimuths=(tx[2],) if surveyed else None,
        site_surveys={"transmitter": (tx[0], tx[1], 0.0)} if surveyed else {},
        noise={"noise_density": NOISE},
        reference=ReferenceTable(times, rx[:2].T, yaw, 0.01),
        plane=True,
        range_scale_std=0.0,  # a sounder counts samples of one clock
        about={
            "campaign": "Tampere 60 GHz",
            "description": "Tampere 60 GHz; odometry simulated from surveyed poses"
            + ("; transmitter known" if surveyed else ""),
        },
    )
