"""The white noise of a snapshot's measurements, and which links share what.

Source: paper, eq. 34, corrected to Q = Q_floor + Q_0 / lambda: a higher SNR lambda means a smaller variance.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Snapshot
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings_kernel import scaled


def white(snapshot: Snapshot, options: MeasurementOptions) -> Floats:
    """Return the white variances (m, 3) of distance (m^2), azimuth and elevation (rad^2) of a snapshot's measurements.

    With noise_model "claimed" the front end's own deviations are taken where it gives them, less the errors that
    persist. A measurement without SNR gets the floor and the variance at 0 dB.
    """
    out: Floats = scaled(snapshot.snr_db, *options.noise)
    if options.noise_model == "claimed":
        columns = (snapshot.distance_std_m, snapshot.azimuth_std_rad, snapshot.elevation_std_rad)
        lasting = np.sum(options.persisting, axis=0)
        for i, column in enumerate(columns):
            if column is not None:
                own = np.maximum(column**2 - lasting[i], 0.01 * column**2)
                out[:, i] = np.where(np.isfinite(column), own, out[:, i])
    return out


def ports_of(site_of: Ints, port: Ints) -> Ints:
    """Return a number for each link (L,) that links of one port of a site share."""
    return np.asarray(site_of, np.int64) * 64 + np.asarray(port, np.int64)


def first_of_link(snapshot: Snapshot, links: int) -> Ints:
    """Return the first measurement of each link (L + 1,)."""
    return np.searchsorted(snapshot.link, np.arange(links + 1))
