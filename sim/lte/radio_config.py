"""Configuration of the radio link and of the receiver's front end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellslam.sim.errors import InputError, one_line
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.own_code import OWN, is_allowed, load_own
from cellslam.sim.waveform import Waveform
from cellslam.sim.waveform.waveform import checked

Floats = NDArray[np.float64]
NOISE_BANDWIDTH_HZ = 15e3  # that `noise_dbm` is given for


class Band(NamedTuple):
    """A band whose detector was measured, and the threshold that lets as many noise peaks through as LTE's does: in a
    wider one there are more places for them."""

    width: str
    threshold: float


LTE_THRESHOLD = 17.4
TECHNOLOGY, STATISTICS = "radio.technology", "radio.statistics_file"
NAMING = (TECHNOLOGY, "radio.antenna_pattern", "radio.path_loss", STATISTICS)  # keys that may name code or a file
SECTOR, FREE_SPACE = "3gpp", "free-space"  # built-in antenna pattern and path loss
FRONT_TO_BACK_DB, SIDELOBE_DB = 25.0, 20.0  # of the sector's antenna
AZIMUTH_WIDTH_RAD, ELEVATION_WIDTH_RAD = np.radians(70.0), np.radians(10.0)  # the same, at 3 dB
NR_BANDS = {48: Band("20 MHz", 17.4), 132: Band("50 MHz", 18.4), 272: Band("100 MHz", 19.2)}  # by blocks of 30 kHz


def threshold_of(keys: dict[str, Any]) -> float:
    """Return the detection threshold of a band whose detector was measured, LTE's where it was not."""
    measured = keys.get("technology") == "nr" and keys.get("resource_blocks") in NR_BANDS
    return NR_BANDS[keys["resource_blocks"]].threshold if measured else LTE_THRESHOLD


class RadioConfig(BaseModel):
    """Carrier, link budget, detector, clutter, clock offsets and the named causes of the error floors."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    front_end: Literal["statistical", "signal"] = Field(
        "statistical",
        description="how measurements are made: drawn from statistics, or estimated from received signals, at "
        "0.15 s of a core a snapshot",
    )
    technology: str = Field(
        "lte",
        pattern=rf"^(lte|nr|{OWN})$",
        description="waveform: lte, nr, or module:Class of one's own (signal level)",
    )
    carrier_hz: float = Field(2.66e9, ge=0.4e9, le=6e9, description="carrier frequency, Hz")
    resource_blocks: int = Field(
        100, ge=6, le=272, description="bandwidth in resource blocks of 12 subcarriers (lte: 6-110, 100: 20 MHz)"
    )
    numerology: int = Field(1, ge=1, le=2, description="nr: subcarriers of 30 or 60 kHz")
    prs_comb: int = Field(12, ge=2, le=12, description="nr: a port sends on every so many-th subcarrier of a symbol")
    prs_symbols: int = Field(12, ge=2, le=12, description="nr: symbols of a slot in which a port sends")

    # At their defaults these four are left out, so that a world is called what it was before there were any.
    statistics_file: str | None = Field(
        None,
        exclude_if=lambda file: file is None,
        description="JSON file with the constants of the statistical detector (not given: those measured in the band)",
    )
    statistics_digest: str = Field(
        "",
        pattern="^([0-9a-f]{16})?$",
        exclude_if=lambda digest: not digest,
        description="first digits of that file's SHA-256: filled in when a scenario is loaded, then it is compared",
    )
    antenna_pattern: str = Field(
        SECTOR,
        pattern=rf"^({SECTOR}|{OWN})$",
        exclude_if=lambda name: name == SECTOR,
        description=f"gain of a sector's antenna over direction: {SECTOR} (TR 36.814), or module:function of one's own",
    )
    path_loss: str = Field(
        FREE_SPACE,
        pattern=rf"^({FREE_SPACE}|{OWN})$",
        exclude_if=lambda name: name == FREE_SPACE,
        description=f"loss over the length of a path: {FREE_SPACE}, or module:function of one's own",
    )

    eirp_dbm: float = Field(
        30.0, ge=-30.0, le=60.0, description="radiated power per reference element and port at boresight, dBm"
    )
    noise_dbm: float = Field(-123.0, ge=-140.0, le=-80.0, description="receiver noise per 15 kHz and array port, dBm")
    load: float = Field(
        0.3, ge=0.0, le=1.0, description="share of other cells' elements that carry data (interference)"
    )
    evm: float = Field(
        0.05, ge=0.0, le=0.3, description="transmitters' error vector magnitude, amplitude ratio (0.05: 5 %)"
    )
    snr_cap_db: float = Field(
        25.0, ge=-10.0, le=60.0, description="highest SNR per sample that the receiver reaches, dB"
    )

    detection_threshold: float = Field(
        default_factory=threshold_of,
        ge=8.0,
        le=40.0,
        description="detection threshold on projected energy over noise variance (not given: that of the band)",
    )
    detection_scale: float = Field(
        1.0, ge=0.0, le=1.0, description="factor on every detection probability (1: nominal)"
    )
    perfect_detection: bool = Field(False, description="detect every path that exists, never merge two")
    window_min_m: float = Field(-50.0, ge=-5000.0, le=0.0, description="start of the searched delay window, m of path")
    window_max_m: float = Field(1700.0, ge=100.0, le=6600.0, description="end of the searched delay window, m of path")

    noise_scale: float = Field(
        1.0, ge=0.0, le=10.0, description="factor on all measurement errors (0: exact measurements)"
    )
    specular_to_diffuse_db: float = Field(
        6.0, ge=0.0, le=40.0, description="specular over diffuse power of a path, dB: error floor and clutter"
    )
    calibration_distance_m: float = Field(0.2, ge=0.0, le=10.0, description="floor: group delay calibration, m")
    calibration_azimuth_deg: float = Field(
        0.25, ge=0.0, le=20.0, description="floor: array calibration in azimuth, deg"
    )
    calibration_elevation_deg: float = Field(
        0.35, ge=0.0, le=20.0, description="floor: array calibration in elevation, deg"
    )
    calibration_correlation_deg: float = Field(
        15.0, ge=0.0, le=180.0, description="turn over which the calibration error changes, deg (0: white errors)"
    )
    array_seed: int | None = Field(
        None, ge=0, description="drives with the same seed share one array's calibration errors (none: of each trial)"
    )
    roof_azimuth_deg: float = Field(
        0.6, ge=0.0, le=20.0, description="floor: scattering off the car's roof, azimuth, deg"
    )
    roof_elevation_deg: float = Field(
        1.2, ge=0.0, le=20.0, description="floor: scattering off the car's roof, elevation, deg"
    )
    roof_correlation_deg: float = Field(
        2.0, ge=0.0, le=180.0, description="turn over which the roof's scattering changes, deg (0: white errors)"
    )
    diffuse_correlation_m: float = Field(
        0.15, ge=0.0, le=100.0, description="distance over which a path's diffuse error changes, m (0: white errors)"
    )
    attitude_azimuth_deg: float = Field(
        0.3, ge=0.0, le=20.0, description="floor: motion of the array within a snapshot, azimuth, deg"
    )
    attitude_elevation_deg: float = Field(
        0.5, ge=0.0, le=20.0, description="floor: motion of the array within a snapshot, elevation, deg"
    )
    attitude_correlation_s: float = Field(
        0.15, ge=0.0, le=100.0, description="time over which the motion within a snapshot changes, s (0: white errors)"
    )

    clutter_scale: float = Field(1.0, ge=0.0, le=20.0, description="factor on the mean number of clutter measurements")
    persisting_clutter: bool = Field(
        False, description="clutter and missed paths last as at signal level (false: redrawn for each snapshot)"
    )
    scatterers: float = Field(
        0.0,
        ge=0.0,
        le=20.0,
        exclude_if=lambda density: density == 0.0,
        description="points that scatter, for each 100 m of wall: features that persist and are no mirrors (0: none)",
    )
    ghost_rule_db: float = Field(
        25.0,
        ge=0.0,
        le=60.0,
        description="a path this much weaker than one within 10 m is dropped as a ghost, dB",
    )

    clock_offset_std_m: float = Field(
        150.0,
        ge=0.0,
        le=5000.0,
        description="standard deviation of each site's clock offset at the start, m (0: known)",
    )
    clock_drift: float = Field(
        0.0,
        ge=0.0,
        le=1e-7,
        description="standard deviation of each site's constant relative frequency error (1e-11: 1.5 m in 500 s)",
    )
    clock_oscillator: Literal["ideal", "rubidium", "ocxo", "tcxo"] = Field(
        "ideal", description="oscillator of the sites, free running: offset and rate walk as it does (ideal: not)"
    )
    clock_steps_per_hour: float = Field(
        0.0, ge=0.0, le=3600.0, description="steps of each site's clock, at random times"
    )
    clock_step_times_s: tuple[float, ...] = Field(
        (), description="further steps of every site's clock, at these times since the first snapshot"
    )
    clock_step_std_m: float = Field(50.0, ge=0.0, le=5000.0, description="standard deviation of the size of a step, m")
    clock_steps_together: bool = Field(
        False, description="all clocks step at once and alike, as when the receiver's own does"
    )

    late_probability: float = Field(
        0.0, ge=0.0, le=1.0, description="share of snapshots whose time stamp is late: measured before it"
    )
    late_s: float = Field(0.05, ge=0.0, le=10.0, description="by how much a late time stamp is late")
    repeat_probability: float = Field(
        0.0, ge=0.0, le=1.0, description="share of snapshots whose report comes again, in place of the next one's"
    )

    @model_validator(mode="after")
    def _check_waveform(self) -> RadioConfig:
        if self.technology == "lte" and self.resource_blocks > 110:
            raise ValueError(f"resource_blocks = {self.resource_blocks}: LTE has 6 to 110 (nr: up to 272)")
        if not (self.statistics_band or self.statistics_file) and self.front_end == "statistical":
            measured = ", ".join(f"{blocks} ({band.width})" for blocks, band in NR_BANDS.items())
            raise ValueError(
                f"technology = '{self.technology}' with these keys has no statistics of its detector: lte has, and nr "
                f"with resource_blocks {measured}, numerology 1, and prs_symbols equal to prs_comb; otherwise set "
                "radio.front_end to signal, or give radio.statistics_file"
            )
        if self.technology == "nr":
            self.waveform()
        return self

    @property
    def statistics_band(self) -> str:
        """Name of the band whose measured constants the statistical front end takes; empty where there are none."""
        if self.technology == "lte":
            return "lte"
        measured = self.technology == "nr" and self.numerology == 1 and self.prs_symbols == self.prs_comb
        return f"nr-{self.resource_blocks}" if measured and self.resource_blocks in NR_BANDS else ""

    def noise_mw(self) -> float:
        """Return the receiver's noise per resource element and array port, in mW."""
        return float(10.0 ** (self.noise_dbm / 10.0) * (self.waveform().element_hz / NOISE_BANDWIDTH_HZ))

    def unasked(self) -> dict[str, str]:
        """Return what these keys name of code and files that this process was not asked for, by dotted key."""
        named = {key: str(getattr(self, key.removeprefix("radio.")) or "") for key in NAMING}
        return {key: name for key, name in named.items() if not is_allowed(key, name)}

    def sector_gain_db(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, tilt_rad: ArrayLike) -> Floats:
        """Return the gain (...,) in dB of a sector's antenna over its greatest, broadcast over its arguments.

        Azimuth from boresight; elevation of the departing path, up positive; down-tilt: all in rad. Raises InputError
        where a pattern of one's own returns something else.
        """
        given = azimuth_rad, elevation_rad, tilt_rad
        if self.antenna_pattern == SECTOR:
            return _sector_gain_db(*given)
        return _asked("radio.antenna_pattern", self.antenna_pattern, np.broadcast(*given).shape, *given)

    def path_gain_factor(self, length_m: Floats, order: NDArray[np.int64]) -> Floats | None:
        """Return by what to multiply the amplitudes (P,) of paths as traced, which are those of free space; None: one.

        `length_m` (P,), `order` (P,): number of reflections and diffractions. Raises InputError where a path loss of
        one's own returns something else than numbers.
        """
        if self.path_loss == FREE_SPACE:
            return None
        loss_db = _asked("radio.path_loss", self.path_loss, length_m.shape, length_m, order, self.carrier_hz)
        return np.asarray(4.0 * np.pi * length_m * self.carrier_hz / SPEED_OF_LIGHT_MPS * 10.0 ** (-loss_db / 20.0))

    def waveform(self) -> Waveform:
        """Return the waveform of these keys: `technology` says which. Raises InputError where there is none."""
        if self.technology == "lte":
            return LteWaveform(self.resource_blocks)
        if self.technology == "nr":
            from cellslam.sim.nr.nr_waveform import NrWaveform

            return NrWaveform(self.resource_blocks, self.numerology, self.prs_comb, self.prs_symbols)
        kind = load_own("radio.technology", self.technology)
        try:
            own = kind(self)
        except Exception as error:
            raise InputError(f"radio.technology '{self.technology}' cannot be made: {one_line(error)}") from error
        return checked(own, self.window_max_m - self.window_min_m)


def _sector_gain_db(azimuth_rad: ArrayLike, elevation_rad: ArrayLike, tilt_rad: ArrayLike) -> Floats:
    """Return the gain (...,) in dB, as `RadioConfig.sector_gain_db` does. Source: 3GPP TR 36.814, Table A.2.1.1-2."""
    below = -np.asarray(elevation_rad, np.float64) - np.asarray(tilt_rad, np.float64)
    horizontal = np.minimum(12.0 * (wrap_angle(azimuth_rad) / AZIMUTH_WIDTH_RAD) ** 2, FRONT_TO_BACK_DB)
    vertical = np.minimum(12.0 * (below / ELEVATION_WIDTH_RAD) ** 2, SIDELOBE_DB)
    return np.asarray(-np.minimum(horizontal + vertical, FRONT_TO_BACK_DB), np.float64)


def _asked(key: str, name: str, shape: tuple[int, ...], *given: Any) -> Floats:
    """Return the numbers that a function of the user's own gives, of this shape. Raises InputError."""
    part: Callable[..., Any] = load_own(key, name)
    try:
        found = np.asarray(part(*given), np.float64)
    except Exception as error:
        error.add_note(f"in the {key} {name}")
        raise
    if found.shape != shape or np.isnan(found).any():
        what = "NaN" if found.shape == shape else f"an array of shape {found.shape}"
        raise InputError(f"{key}: {name} returned {what}, where numbers of shape {shape} are needed")
    return found
