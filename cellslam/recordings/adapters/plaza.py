"""Adapter for the Plaza data sets: a vehicle, odometry, and ranges to four radio beacons.

One MATLAB file (`Plaza1_.mat`, `Plaza2_.mat`) with the matrices DR (time in s, distance travelled in m and change of
heading in rad since the row before), TD (time, antenna, beacon, range in m), GT (time, x, y in m, heading in rad) and
TL (beacon, x, y in m); or text files of these names, as `Plaza1_DR.txt`, GT and TL if they are there. The vehicle
moves along its heading in the middle of a step. Beacons say who they are, so each is a link. Source: J. Djugash,
B. Hamner and S. Roth, Navigating with ranging radios: five data sets with ground truth, Journal of Field Robotics
26(9), 2009, and the files that come with it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.recordings.adapters.shared import increasing, is_known, matrix, only
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.matlab import variables
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats

COLUMNS = {
    "DR": ("time", "distance", "heading change"),
    "TD": ("time", "antenna", "beacon", "range"),
    "GT": ("time", "x", "y", "heading"),
    "TL": ("beacon", "x", "y"),
}
NEEDED = ("DR", "TD")
# Of wheels and a gyro on grass; none is published.
SHEET = {
    "noise_density": (0.1, 0.0, 0.0, 0.01, 0.0, 0.0),
    "bias": (0.0, 0.0, 0.0, 0.002, 0.0, 0.0),
    "scale": (0.03, 0.0, 0.0, 0.03, 0.0, 0.0),
}


def load(folder: Path, *, sites: str = "unknown") -> Campaign:
    """Return the campaign of a .mat file, or of the one that `folder` holds; without GT it starts at the origin.

    `sites`: "known", the beacons stand where TL has them, in the frame of GT. Raises InputError.
    """
    surveyed, tables = is_known("sites", sites), _tables(folder)
    if surveyed and not {"GT", "TL"} <= set(tables):
        raise InputError(f"{folder}: has no GT and TL, which say where the beacons stand: leave out sites = 'known'")
    steps, ranges = increasing(tables["DR"]), np.unique(tables["TD"], axis=0)
    path = increasing(tables["GT"]) if "GT" in tables else None
    # A row is what happened since the row before; of the first, only a pose before it tells since when.
    begins = path is not None and path[0, 0] < steps[0, 0]
    before = path[0, 0] if begins and path is not None else np.nan
    lasts = np.diff(steps[:, 0], prepend=before)[:, None]
    rates = (steps[:, 1:] / lasts)[0 if begins else 1 :]
    times = steps[0 if begins else 1 :, 0]
    inside = (ranges[:, 0] >= (before if begins else steps[0, 0])) & (ranges[:, 0] <= times[-1]) & (ranges[:, 3] > 0.0)
    if not inside.any():
        raise InputError(f"{folder}: no range was measured while the odometry ran: are DR and TD of one drive?")
    ranges = ranges[inside]
    beacons, link = np.unique(ranges[:, 2], return_inverse=True)
    return Campaign(
        time_s=ranges[:, 0],
        columns={"distance_m": ranges[:, 3]},
        link=link,
        link_sites=[_name(beacon) for beacon in beacons],
        site_surveys={_name(row[0]): (*row[1:], 0.0) for row in tables["TL"] if row[0] in beacons} if surveyed else {},
        odometry=OdometryTable(times, {"u_x": rates[:, 0], "u_psi": rates[:, 1]}, hold="before"),
        noise=SHEET,
        start_pose=(0.0,) * 6 if path is None else None,
        reference=None if path is None else ReferenceTable(path[:, 0], path[:, 1:3], heading(path)),
        plane=True,
        about={
            "campaign": "Plaza",
            "description": folder.name + (", beacons known" if surveyed else ""),
            "beacons_m": {str(int(row[0])): row[1:].tolist() for row in tables.get("TL", ())},
        },
    )


def _name(beacon: float) -> str:
    return f"beacon {int(beacon)}"


def heading(path: Floats) -> Floats:
    """Return the headings (N,) in rad of a path (N, 4), turned by pi where it drives against them: so does Plaza 2."""
    step = np.diff(path[:, 1:3], axis=0)
    moves = np.hypot(*step.T) > 0.2 * np.hypot(*step.T).max()
    apart = wrap_angle(np.arctan2(step[:, 1], step[:, 0]) - path[:-1, 3])[moves]
    backwards = np.cos(apart).mean() < 0.0 if len(apart) else False
    return wrap_angle(path[:, 3] + (np.pi if backwards else 0.0))


def _tables(folder: Path) -> dict[str, Floats]:
    """Return DR, TD and, where they are there, GT and TL."""
    if folder.is_dir():
        folder = only(folder, "*.mat", "*DR.txt")
    if folder.suffix == ".mat":
        read = variables(folder, NEEDED)
        tables = {name: np.atleast_2d(np.asarray(read[name], np.float64)) for name in COLUMNS if name in read}
        for name, table in tables.items():
            if table.ndim != 2 or table.shape[1] != len(COLUMNS[name]):
                raise InputError(f"{folder}: {name} has shape {table.shape}, expected (N, {len(COLUMNS[name])})")
        return tables
    stem = folder.name.removesuffix("DR.txt")
    paths = {name: folder.with_name(f"{stem}{name}.txt") for name in COLUMNS}
    return {name: matrix(path, COLUMNS[name]) for name, path in paths.items() if name in NEEDED or path.is_file()}
