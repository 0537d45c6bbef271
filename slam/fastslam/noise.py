"""Measurement variances: Q = Q_floor + Q_0 / lambda, lambda the linear SNR (paper, section IV, corrected: more SNR,
less variance)."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.api import Snapshot
from cellslam.slam.fastslam.options import FastSlamOptions


def variances(snapshot: Snapshot, options: FastSlamOptions) -> Floats:
    """Return the variances (m, 3) of distance (m^2), azimuth and elevation (rad^2) of a snapshot's measurements.

    With noise_model "claimed" the front end's own deviations are taken where it gives them. A measurement without SNR
    gets
    the floor and the variance at 0 dB.
    """
    o = options
    floor = np.array([o.noise_floor_m, np.radians(o.noise_floor_azimuth_deg), np.radians(o.noise_floor_elevation_deg)])
    unit = np.array(
        [
            o.noise_unit_snr_m,
            np.radians(o.noise_unit_snr_azimuth_deg),
            np.radians(o.noise_unit_snr_elevation_deg),
        ]
    )
    snr_db = np.where(np.isnan(snapshot.snr_db), 0.0, snapshot.snr_db)
    out = floor**2 + unit**2 * 10.0 ** (-snr_db / 10.0)[:, None]
    if o.noise_model == "claimed":
        columns = (snapshot.distance_std_m, snapshot.azimuth_std_rad, snapshot.elevation_std_rad)
        for i, column in enumerate(columns):
            if column is not None:
                out[:, i] = np.where(np.isfinite(column), column**2, out[:, i])
    return out
