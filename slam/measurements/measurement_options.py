"""What estimators assume of the front end: detection, clutter, coming and going of VTs, and errors that persist.

Errors of a measurement, cause by cause, as `sim.lte` makes them:

    white         R = R_floor + R_0 / lambda, lambda the linear SNR (paper, section IV, where it is Q; corrected: more
                  SNR, less variance)
    diffuse, sway   diffuse energy: changes over a fraction of a metre, the same for the links of one port of a site;
                  the array's sway: over a fraction of a second, the same for all paths
    calibration, roof   functions of the direction of arrival in the body frame: alike for all paths from about one
                  direction, and they change only as the direction changes

A filter either has states for what persists (the joint filters), or none (PHD-SLAM, the smoother). Without states a
single measurement has the sum of the variances: association takes that. Many measurements in a row share one draw of an
error: the mean of n of them has the variance of n / repeats independent ones. So an update takes the variance times
`repeats`, and times the links that share the draw.

Sources: paper, eq. 34, corrected; Priestley, "Spectral analysis and time series", 1981, section 5.3 (variance of the
mean of a correlated sequence); Musicki, Evans and Stankovic, "Integrated probabilistic data association", IEEE Trans.
Automatic Control 39(6), 1994 (existence as a Markov chain, and a miss by Bayes' rule).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.recording import Floats

# Options of a front end whose errors are white.
NOTHING_PERSISTS = {
    "calibration_m": 0.0, "calibration_azimuth_deg": 0.0, "calibration_elevation_deg": 0.0, "roof_azimuth_deg": 0.0,
    "roof_elevation_deg": 0.0, "diffuse_m": 0.0, "diffuse_azimuth_deg": 0.0, "diffuse_elevation_deg": 0.0,
    "sway_azimuth_deg": 0.0, "sway_elevation_deg": 0.0,
}  # fmt: skip
MERGED = 0.1  # of the roof's variance: what paths that merge do to directions
HORIZON = 4096  # snapshots for which the chance of being visible is tabulated


class MeasurementOptions(BaseModel):
    """The options that map builders share; defaults for the statistical LTE front end."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection_probability: float = Field(
        0.88, gt=0, lt=1, description="probability that a visible VT is detected in one snapshot and link"
    )
    clutter_density: float = Field(
        1e-2, gt=0, le=1e3, description="clutter per link and snapshot and unit of (m rad rad), where VTs are"
    )
    birth_ratio: float = Field(
        0.01, gt=0, lt=1, description="probability that an unexplained measurement is a new VT rather than clutter"
    )
    visible_s: float = Field(10.0, gt=0, le=1e4, description="mean time for which a VT stays visible, s")
    hidden_s: float = Field(10.0, gt=0, le=1e5, description="mean time for which a known VT stays hidden, s")
    confirm_hits: int = Field(5, ge=1, le=100, description="detections after which a VT is confirmed")
    drop_probability: float = Field(
        1e-4, gt=0, lt=1, description="an unconfirmed VT less likely than this to be visible is dropped"
    )
    gate: float = Field(
        16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which nothing associates (chi-square)"
    )
    noise_model: Literal["snr", "claimed"] = Field(
        "snr", description="measurement covariance: scaled by the SNR, or as the front end claims per path"
    )
    noise_floor_m: float = Field(0.0, ge=0, le=100, description="white distance deviation at infinite SNR, m")
    noise_floor_azimuth_deg: float = Field(0.0, ge=0, le=90, description="the same for azimuth, deg")
    noise_floor_elevation_deg: float = Field(0.0, ge=0, le=90, description="the same for elevation, deg")
    noise_unit_snr_m: float = Field(0.0405, ge=0, le=1000, description="distance deviation due to noise at 0 dB, m")
    noise_unit_snr_azimuth_deg: float = Field(0.0685, ge=0, le=90, description="the same for azimuth, deg")
    noise_unit_snr_elevation_deg: float = Field(0.0704, ge=0, le=90, description="the same for elevation, deg")
    calibration_m: float = Field(
        0.2, ge=0, le=100, description="distance error of the array's calibration, a function of the direction, m"
    )
    calibration_azimuth_deg: float = Field(0.25, ge=0, le=90, description="the same for azimuth, deg")
    calibration_elevation_deg: float = Field(0.35, ge=0, le=90, description="the same for elevation, deg")
    calibration_scale_deg: float = Field(
        15.0, ge=0, le=180, description="change of direction over which it is redrawn, deg; 0: white"
    )
    roof_azimuth_deg: float = Field(
        0.6, ge=0, le=90, description="azimuth error by scattering of the roof, a function of the direction, deg"
    )
    roof_elevation_deg: float = Field(1.2, ge=0, le=90, description="the same for elevation, deg")
    roof_scale_deg: float = Field(
        2.0, ge=0, le=180, description="change of direction over which it is redrawn, deg; 0: white"
    )
    diffuse_m: float = Field(0.71, ge=0, le=100, description="distance error by diffuse energy, of each VT and port, m")
    diffuse_azimuth_deg: float = Field(0.75, ge=0, le=90, description="the same for azimuth, deg")
    diffuse_elevation_deg: float = Field(0.51, ge=0, le=90, description="the same for elevation, deg")
    diffuse_scale_m: float = Field(0.15, ge=0, le=1000, description="distance over which it is redrawn, m; 0: white")
    sway_azimuth_deg: float = Field(
        0.3, ge=0, le=90, description="azimuth error of all paths of a snapshot, as the array sways, deg"
    )
    sway_elevation_deg: float = Field(0.5, ge=0, le=90, description="the same for elevation (pitch and roll), deg")
    sway_scale_s: float = Field(0.15, ge=0, le=1000, description="time over which it is redrawn, s; 0: white")
    sharing: Literal["none", "site"] = Field(
        "site", description="whether what the ports and sectors of a site measure of a path is taken together"
    )
    misfit_scale_s: float = Field(
        20.0, ge=0, le=1e4, description="time over which directions show to be worse than expected, s; 0: never"
    )
    pitch_deg: float = Field(
        0.1, ge=0, le=20, description="deviation of a pitch that the odometry does not see, deg; 0: level"
    )
    roll_deg: float = Field(0.3, ge=0, le=20, description="the same for roll, deg; 0: level")
    attitude_scale_s: float = Field(3.0, gt=0, le=1e4, description="time over which pitch and roll change, s")
    typical_range_m: float = Field(
        200.0, gt=0, le=1e5, description="distance of a typical VT: driving on turns its direction by speed / range, m"
    )

    @cached_property
    def noise(self) -> tuple[Floats, Floats]:
        """White variances (3,) in m^2, rad^2, rad^2: at infinite SNR, and what noise adds at 0 dB."""
        floor = self.noise_floor_m, self.noise_floor_azimuth_deg, self.noise_floor_elevation_deg
        unit = self.noise_unit_snr_m, self.noise_unit_snr_azimuth_deg, self.noise_unit_snr_elevation_deg
        return _variances(*floor), _variances(*unit)

    @cached_property
    def calibration(self) -> Floats:
        """Deviations (3,) in m and rad of the array's calibration."""
        return _deviations(self.calibration_m, self.calibration_azimuth_deg, self.calibration_elevation_deg)

    @cached_property
    def roof(self) -> Floats:
        """Deviations (3,) in m and rad of what the roof scatters."""
        return _deviations(0.0, self.roof_azimuth_deg, self.roof_elevation_deg)

    @cached_property
    def diffuse(self) -> Floats:
        """Deviations (3,) in m and rad of what diffuse energy does to a path in one port."""
        return _deviations(self.diffuse_m, self.diffuse_azimuth_deg, self.diffuse_elevation_deg)

    @cached_property
    def sway(self) -> Floats:
        """Deviations (3,) in m and rad of what the array's sway does to a direction."""
        return _deviations(0.0, self.sway_azimuth_deg, self.sway_elevation_deg)

    @cached_property
    def persisting(self) -> tuple[Floats, Floats]:
        """Variances (3,) in m^2, rad^2, rad^2 of the errors of place (diffuse, sway) and of direction (calibration,
        roof)."""
        return self.diffuse**2 + self.sway**2, self.calibration**2 + self.roof**2

    @cached_property
    def beside_states(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Variances for a filter that has what persists as states, in m^2 and rad^2: of causes without a scale, which
        are white, (2, 3), in all and by port; and (3,) of diffuse errors and of sway with one, and of what paths that
        merge do to directions."""
        diffuse, sway = self.diffuse**2, self.sway**2
        lasts, sways = self.diffuse_scale_m > 0.0, self.sway_scale_s > 0.0
        plain = sway * (not sways) + self.calibration**2 * (self.calibration_scale_deg == 0.0)
        plain += self.roof**2 * (self.roof_scale_deg == 0.0)
        merged = MERGED * self.roof**2 * (self.roof_scale_deg > 0.0)
        return np.stack([plain, diffuse * (not lasts)]), diffuse * lasts, sway * sways, merged

    @cached_property
    def scales(self) -> Floats:
        """Over what errors are redrawn (4,): distance (m) for those of place, change of direction (rad) for those of
        direction in distance and in angles, and how far off VTs are for that (m).

        In angles the mean of both scales by the variances of azimuth, or of elevation where azimuth has none.
        """
        of = 1 if self.persisting[1][1] > 0.0 else 2
        by = np.array([self.calibration[of] ** 2, self.roof[of] ** 2]) + 1e-30
        scales_deg = np.array([self.calibration_scale_deg, self.roof_scale_deg])
        angle = math.radians(float(by @ scales_deg / by.sum()))
        return np.array([self.diffuse_scale_m, math.radians(self.calibration_scale_deg), angle, self.typical_range_m])


def _deviations(distance_m: float, azimuth_deg: float, elevation_deg: float) -> Floats:
    return np.array([distance_m, math.radians(azimuth_deg), math.radians(elevation_deg)])


def _variances(distance_m: float, azimuth_deg: float, elevation_deg: float) -> Floats:
    return np.square(_deviations(distance_m, azimuth_deg, elevation_deg))


def visibility(first: float, stay: float, back: float, detection: float, length: int) -> Floats:
    """Return P(visible) before the n-th snapshot since the last detection, (length,); entry 0 is unused: `first`.

    `first`: P(visible) just after the detection; `stay`, `back`: transition probabilities to visible.
    """
    out = np.empty(length)
    out[0] = r = first
    for n in range(1, length):
        out[n] = r = r * stay + (1.0 - r) * back
        r = r * (1.0 - detection) / (1.0 - r * detection)
    return out


def transitions(options: MeasurementOptions, interval_s: float) -> tuple[float, float]:
    """Return the probabilities that in an interval a visible VT stays so, and that a hidden one comes back."""
    return float(np.exp(-interval_s / options.visible_s)), float(-np.expm1(-interval_s / options.hidden_s))


def existence(options: MeasurementOptions, interval_s: float) -> tuple[Floats, int, int]:
    """Return log tables (2, 2, HORIZON) of P(visible and detected) and P(missed), and ages at which to drop VTs.

    First index: VTs detected once, others. A VT is visible or hidden, a two-state Markov chain; a visible one is
    detected with probability p_D; each miss lowers that by Bayes' rule. A VT that was seen once exists with the birth
    probability only, and does not come back: this is what makes a birth pay for itself.
    """
    o, (stay, back) = options, transitions(options, interval_s)
    once = visibility(o.birth_ratio, stay, 0.0, o.detection_probability, HORIZON)
    twice = visibility(1.0, stay, 0.0, o.detection_probability, HORIZON)
    known = visibility(1.0, stay, back, o.detection_probability, HORIZON)
    kept = [np.maximum(r, 1e-12) * o.detection_probability for r in (once, known)]
    table = np.stack([[np.log(r), np.log1p(-r)] for r in kept])
    ages = [int(np.argmax(np.append(r, 0.0) < o.drop_probability)) for r in (once, twice)]
    return table, ages[0], ages[1]
