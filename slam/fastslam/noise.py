"""Measurement variances: white ones that shrink with the SNR, persisting ones that averaging does not remove.

White: Q = Q_floor + Q_0 / lambda, lambda the linear SNR (paper, section IV, corrected: more SNR, less variance).

Persisting: calibration of the array and scattering by the roof are functions of the direction of arrival in the body
frame. All links
that see a VT share its error, and it changes only as the direction changes, so many measurements are one draw. With
autocorrelation
rho between snapshots the mean of many behaves as if each had the variance times (1 + rho) / (1 - rho); to associate,
a single
measurement still has the plain sum of both variances.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Snapshot
from cellslam.slam.fastslam.options import FastSlamOptions

MOST_REPEATS = 1e5  # standing still, a persisting error is never drawn anew: nearly no information


def white(snapshot: Snapshot, options: FastSlamOptions) -> Floats:
    """Return the white variances (m, 3) of distance (m^2), azimuth and elevation (rad^2) of a snapshot's measurements.

    With noise_model "claimed" the front end's own deviations are taken where it gives them, less the persisting part.
    A measurement
    without SNR gets the floor and the variance at 0 dB.
    """
    o = options
    floor = np.array([o.noise_floor_m, np.radians(o.noise_floor_azimuth_deg), np.radians(o.noise_floor_elevation_deg)])
    unit = np.array(
        [o.noise_unit_snr_m, np.radians(o.noise_unit_snr_azimuth_deg), np.radians(o.noise_unit_snr_elevation_deg)]
    )
    snr_db = np.where(np.isnan(snapshot.snr_db), 0.0, snapshot.snr_db)
    out: Floats = floor**2 + unit**2 * 10.0 ** (-snr_db / 10.0)[:, None]
    if o.noise_model == "claimed":
        columns = (snapshot.distance_std_m, snapshot.azimuth_std_rad, snapshot.elevation_std_rad)
        for i, column in enumerate(columns):
            if column is not None:
                own = np.maximum(column**2 - persisting(o)[i], 0.01 * column**2)
                out[:, i] = np.where(np.isfinite(column), own, out[:, i])
    return out


def persisting(options: FastSlamOptions) -> Floats:
    """Return the persisting variances (3,): m^2, rad^2, rad^2."""
    o = options
    angles = np.radians([o.persisting_azimuth_deg, o.persisting_elevation_deg])
    return np.array([o.persisting_m, *angles]) ** 2


def repeats(options: FastSlamOptions, turn_rad: float, moved_m: float) -> float:
    """Return how many snapshots share one draw of a persisting error, when an interval turns and moves the vehicle so
    far."""
    change = abs(turn_rad) + abs(moved_m) / options.persisting_range_m
    rho = np.exp(-change / np.radians(options.persisting_scale_deg))
    return float(min((1.0 + rho) / max(1.0 - rho, 1e-9), MOST_REPEATS))


def sharers(snapshot: Snapshot, site_of: Ints, q: Floats) -> Floats:
    """Return for each measurement (m,) how many of its site's links measured the same path, itself included, by
    variances q (m, 3)."""
    site = site_of[snapshot.link]
    close = site[:, None] == site[None, :]
    columns = (snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad)
    for i, column in enumerate(columns):
        gap = column[:, None] - column[None, :]
        gap = wrap_angle(gap) if i == 1 else gap
        close &= ~(gap * gap > 9.0 * (q[:, None, i] + q[None, :, i]))
    same_link = snapshot.link[:, None] == snapshot.link[None, :]
    close &= ~same_link | np.eye(len(snapshot), dtype=bool)
    count: Floats = close.sum(axis=1).astype(np.float64)
    return count


def packed(snapshot: Snapshot, site_of: Ints, options: FastSlamOptions, repeated: float) -> tuple[Floats, Floats]:
    """Return the measurements as the kernels want them, (m, 12) each: to associate, and to update with.

    Distance, cos and sin of azimuth and of elevation, three variances, three flags: 1 measured, 0 not (then the
    variance is 1); last,
    half the log of the ratio of the variances' products: what an update's density lacks against that of one
    measurement.
    """
    alone, lasting = white(snapshot, options), persisting(options)
    single = alone + lasting
    many = alone + lasting * (repeated * sharers(snapshot, site_of, single))[:, None]
    known = ~np.isnan([snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad]).T
    d, az, el = (np.nan_to_num(c) for c in (snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad))
    directions = (d, np.cos(az), np.sin(az), np.cos(el), np.sin(el))
    lack = 0.5 * np.where(known, np.log(many / single), 0.0).sum(axis=1)

    def table(q: Floats) -> Floats:
        return np.ascontiguousarray(np.column_stack([*directions, np.where(known, q, 1.0), known.astype(float), lack]))

    return table(single), table(many)
