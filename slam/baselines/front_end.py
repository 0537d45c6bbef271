"""What the baselines assume of the front end: detection, clutter, visibility, noise. Defaults as FastSLAM's."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Snapshot

# Widths of the clutter in distance (m), azimuth and elevation (rad): what a missing component takes off its density.
CLUTTER_WIDTH = (1000.0, 2.0 * np.pi, np.pi / 2.0)


class FrontEndOptions(BaseModel):
    """The options that all map-building baselines share; defaults for the statistical LTE front end."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection_probability: float = Field(
        0.9, gt=0, lt=1, description="probability that a visible VT is detected in one snapshot and link"
    )
    clutter_density: float = Field(
        1e-4, gt=0, le=1e3, description="clutter per link and snapshot and unit of (m rad rad)"
    )
    birth_ratio: float = Field(
        0.01, gt=0, lt=1, description="probability that an unexplained measurement is a new VT rather than clutter"
    )
    visible_s: float = Field(10.0, gt=0, le=1e4, description="mean time for which a VT stays visible, s")
    hidden_s: float = Field(10.0, gt=0, le=1e5, description="mean time for which a known VT stays hidden, s")
    confirm_hits: int = Field(3, ge=1, le=100, description="detections after which a VT is confirmed")
    drop_probability: float = Field(
        1e-4, gt=0, lt=1, description="an unconfirmed VT less likely than this to be visible is dropped"
    )
    gate: float = Field(
        16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which nothing associates (chi-square)"
    )
    noise_model: Literal["snr", "claimed"] = Field(
        "claimed", description="measurement covariance: as the front end claims per path, or scaled by the SNR"
    )
    angle_scale: float = Field(
        3.0,
        gt=0,
        le=100,
        description="factor on the angles' deviations: their errors persist from snapshot to snapshot",
    )
    noise_floor_m: float = Field(0.6, ge=0, le=100, description="distance deviation at infinite SNR, m")
    noise_floor_azimuth_deg: float = Field(1.0, ge=0, le=90, description="azimuth deviation at infinite SNR, deg")
    noise_floor_elevation_deg: float = Field(1.5, ge=0, le=90, description="elevation deviation at infinite SNR, deg")
    noise_unit_snr_m: float = Field(0.0405, ge=0, le=1000, description="distance deviation due to noise at 0 dB, m")
    noise_unit_snr_azimuth_deg: float = Field(
        0.0685, ge=0, le=90, description="azimuth deviation due to noise at 0 dB, deg"
    )
    noise_unit_snr_elevation_deg: float = Field(
        0.0704, ge=0, le=90, description="elevation deviation due to noise at 0 dB, deg"
    )


def columns(snapshot: Snapshot, options: FrontEndOptions) -> tuple[Floats, Floats, Floats]:
    """Return measurements z (m, 3), their variances q (m, 3), and the log-width of clutter in what is missing (m,).

    q = floor^2 + unit^2 / SNR (paper, section IV: more SNR, less variance), or what the front end claims.
    """
    o = options
    z = np.stack([snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad], axis=1)
    degrees = np.array([1.0, np.pi / 180.0, np.pi / 180.0])
    floor = degrees * [o.noise_floor_m, o.noise_floor_azimuth_deg, o.noise_floor_elevation_deg]
    unit = degrees * [o.noise_unit_snr_m, o.noise_unit_snr_azimuth_deg, o.noise_unit_snr_elevation_deg]
    snr_db = np.where(np.isnan(snapshot.snr_db), 0.0, snapshot.snr_db)
    q = floor**2 + unit**2 * 10.0 ** (-snr_db / 10.0)[:, None]
    if o.noise_model == "claimed":
        for i, claimed in enumerate((snapshot.distance_std_m, snapshot.azimuth_std_rad, snapshot.elevation_std_rad)):
            if claimed is not None:
                q[:, i] = np.where(np.isfinite(claimed), claimed**2, q[:, i])
    q[:, 1:] *= o.angle_scale**2
    gap = np.isnan(z) @ np.log(CLUTTER_WIDTH)
    return z, np.maximum(q, 1e-12), gap


def first_of_link(snapshot: Snapshot, links: int) -> Ints:
    """Return the first measurement of each link (L + 1,)."""
    return np.searchsorted(snapshot.link, np.arange(links + 1)).astype(np.int64)


def existence(options: FrontEndOptions, interval_s: float) -> tuple[Floats, int, int]:
    """Return log tables (2, 2, ages) of P(visible and detected) and P(missed), and ages at which to drop VTs.

    First index: VTs detected once, others. The model, a two-state Markov chain, is that of `fastslam.existence`.
    """
    from cellslam.slam.fastslam.existence import HORIZON, visibility

    o = options
    stay, back = float(np.exp(-interval_s / o.visible_s)), float(-np.expm1(-interval_s / o.hidden_s))
    once = visibility(o.birth_ratio, stay, 0.0, o.detection_probability, HORIZON)
    twice = visibility(1.0, stay, 0.0, o.detection_probability, HORIZON)
    known = visibility(1.0, stay, back, o.detection_probability, HORIZON)
    kept = [np.maximum(r, 1e-12) * o.detection_probability for r in (once, known)]
    table = np.stack([[np.log(r), np.log1p(-r)] for r in kept])
    ages = [int(np.argmax(np.append(r, 0.0) < o.drop_probability)) for r in (once, twice)]
    return table, ages[0], ages[1]
