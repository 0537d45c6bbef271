"""Adapter for MRCLAM, the UTIAS multi-robot data sets: odometry, ranges and bearings to bar codes, motion capture.

A folder MRCLAM_Dataset1 to 9 of text files, # begins a comment: `Barcodes.dat` (subject, barcode),
`Landmark_Groundtruth.dat` (subject, x, y in m, their deviations), and for each robot `Robot1_Odometry.dat` (time in s,
forward velocity in m/s, angular velocity in rad/s: commands, valid until the next), `Robot1_Measurement.dat` (time,
barcode, range in m, bearing in rad, counter-clockwise from ahead) and `Robot1_Groundtruth.dat` (time, x, y in m,
heading in rad). Subjects 1 to 5 are the robots, the others landmarks. Source: K. Leung, Y. Halpern, T. Barfoot and
H. Liu, The UTIAS multi-robot cooperative localization and mapping dataset, International Journal of Robotics Research
30(8), 2011, and its page http://asrl.utias.utoronto.ca/datasets/mrclam.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.recordings.adapters.shared import increasing, is_known, matrix
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.sim.errors import InputError

ROBOTS = 5
# Of commands to a small differential drive on a smooth floor; none is published.
SHEET = {
    "noise_density": (0.03, 0.0, 0.0, 0.05, 0.0, 0.0),
    "bias": (0.0, 0.0, 0.0, 0.005, 0.0, 0.0),
    "scale": (0.05, 0.0, 0.0, 0.05, 0.0, 0.0),
}


def load(folder: Path, *, robot: int = 1, association: str = "unknown", sites: str = "unknown") -> Campaign:
    """Return the campaign of one robot; sightings of the other robots, which move, are left out.

    `association`: "unknown", bar codes are not looked at and all landmarks share a link, misread ones are clutter;
    "known", each landmark is a link of its own. `sites`: "known", the landmarks' positions are known, too, with the
    deviations in the file. Raises InputError.
    """
    known, surveyed = is_known("association", association), is_known("sites", sites)
    if surveyed and not known:
        raise InputError("sites = 'known' needs association = 'known': a position is that of one landmark")
    if robot not in range(1, ROBOTS + 1):
        raise InputError(f"robot = {robot}: give 1 to {ROBOTS}")
    codes = matrix(folder / "Barcodes.dat", ("subject", "barcode"))
    landmarks = matrix(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "x deviation", "y deviation"))
    odometry = increasing(matrix(folder / f"Robot{robot}_Odometry.dat", ("time", "v", "omega")))
    truth = increasing(matrix(folder / f"Robot{robot}_Groundtruth.dat", ("time", "x", "y", "heading")))
    seen = np.unique(matrix(folder / f"Robot{robot}_Measurement.dat", ("time", "barcode", "range", "bearing")), axis=0)
    subject_of = {int(code): int(subject) for subject, code in codes}
    subject = np.array([subject_of.get(int(code), 0) for code in seen[:, 1]])
    kept = (subject > ROBOTS if known else ~np.isin(subject, range(1, ROBOTS + 1))) & (seen[:, 0] >= odometry[0, 0])
    if not kept.any():
        raise InputError(f"{folder}: robot {robot} saw no landmark that Barcodes.dat knows")
    numbers = np.unique(subject[kept]) if known else np.zeros(1)
    surveys = {_name(row[0]): (*row[1:3], 0.0, *row[3:5], 0.0) for row in landmarks if row[0] in numbers}
    return Campaign(
        time_s=seen[kept, 0],
        columns={"distance_m": seen[kept, 2], "azimuth_rad": seen[kept, 3]},
        link=np.searchsorted(numbers, subject[kept]) if known else None,
        link_sites=[_name(number) for number in numbers] if known else ("landmarks",),
        site_surveys=surveys if surveyed else {},
        odometry=OdometryTable(odometry[:, 0], {"u_x": odometry[:, 1], "u_psi": odometry[:, 2]}, valid_s=np.inf),
        noise=SHEET,
        reference=ReferenceTable(truth[:, 0], truth[:, 1:3], truth[:, 3]),
        plane=True,
        scatterers=False,  # landmarks are measured themselves
        about={
            "campaign": "MRCLAM",
            "description": f"{folder.name}, robot {robot}, association {association}"
            + (", landmarks known" if surveyed else ""),
            "landmarks_m": {str(int(row[0])): row[1:3].tolist() for row in landmarks},
        },
    )


def _name(subject: float) -> str:
    return f"landmark {int(subject)}"
