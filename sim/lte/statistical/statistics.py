"""Constants of the statistical front end, as the calibration study measured them (`python -m tools calibrate`): a file
a band, for what a receiver resolves is another thing in another bandwidth.

Source: measured; how, studies/front-end-calibration.md.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.lte.radio_config import STATISTICS, RadioConfig
from cellslam.sim.lte.statistical.detector_layout import Standing
from cellslam.sim.own_code import allow, is_allowed
from cellslam.sim.recording import Floats

LTE = "lte"  # whose constants, measured at 20 MHz, serve all of its bandwidths
BLUR_M, BLUR_BAND_HZ = 4.0, 18e6  # of clutter drawn in another place than it was measured, in this band


def file_of(band: str = LTE) -> Path:
    """Return where the constants of a band are, as `RadioConfig.statistics_band` names it."""
    return Path(__file__).with_name("statistics.json" if band == LTE else f"statistics-{band}.json")


@dataclass(frozen=True)
class Clutter:
    """Clutter around a path over nodes (G,) of its integrated SNR: mean number (G,), and points of it (G, N, 4): how
    much later (m), azimuth and elevation beside it (rad), SNR (dB).
    """

    mean: Floats
    points: Floats


@dataclass(frozen=True, eq=False)
class Statistics:
    """Detection: P(T > x) = ncx2.sf(2 x, dof, gain Gamma) of an isolated path, a logistic (dB) of one among others.

    `trail`, `around`: disturbance behind a path at a specular-to-diffuse ratio of 0 dB, in its direction and in all;
    `sidelobes`: share of it that spreads over `sidelobe_m` of delay. `noise_cells`: noise peaks over x are Poisson
    with mean noise_cells exp(-x) (1 + x). `diffuse_floor` (3,) in m, rad, rad at 0 dB. By ratio in dB: `company`, how
    many times as much clutter there is around a path among others as around a lone one; `clutter`, whose points are
    blurred by `blur_m`. `standing`: what of clutter and misses stands still.
    """

    dof: float
    gain: float
    overlap_centre_db: float
    overlap_width_db: float
    trail: float
    around: float
    sidelobes: float
    sidelobe_m: float
    noise_cells: float
    diffuse_floor: tuple[float, float, float]
    company: tuple[tuple[float, float], ...]
    clutter: tuple[tuple[float, Clutter], ...]
    blur_m: float
    standing: Standing

    def company_at(self, ratio_db: float) -> float:
        """Return `company` at a specular-to-diffuse ratio."""
        return float(np.interp(ratio_db, [ratio for ratio, _ in self.company], [factor for _, factor in self.company]))

    def clutter_at(self, ratio_db: float) -> Clutter:
        """Return the clutter at a specular-to-diffuse ratio, interpolated between those that were measured."""
        ratios = [ratio for ratio, _ in self.clutter]
        at = float(np.interp(ratio_db, ratios, np.arange(len(ratios))))
        low = min(int(at), len(ratios) - 2)
        (_, one), (_, other), part = self.clutter[low], self.clutter[low + 1], at - low
        # Of the points every so many-th is the other ratio's.
        count = one.points.shape[1]
        from_other = np.diff(np.floor(part * np.arange(count + 1))) > 0.0
        points = np.where(from_other[None, :, None], other.points, one.points)
        return Clutter((1.0 - part) * one.mean + part * other.mean, np.ascontiguousarray(points))


@lru_cache(maxsize=8)
def statistics(band: str = LTE) -> Statistics:
    """Return the constants of a band that are shipped with the package."""
    return parse(json.loads(file_of(band).read_text(encoding="utf-8")))


def statistics_of(config: RadioConfig, asked: bool = False) -> Statistics:
    """Return the constants that a radio configuration asks for: those of its band, or of a file.

    `asked`: the user gave the configuration. One that a recording holds may name any file of this machine: only what
    the user has asked for before is read. Raises InputError.
    """
    if config.statistics_file is None:
        return statistics(config.statistics_band or LTE)
    file, expected = config.statistics_file, config.statistics_digest
    if asked:
        allow(STATISTICS, file)
    if not is_allowed(STATISTICS, file):
        raise InputError(
            f"the recording names a file, radio.statistics_file = '{file}', which is not read unasked; if you trust "
            f"it, give it again: --set radio.statistics_file={file}"
        )
    text = _text_of(file)
    if expected not in ("", _digest(text)):
        raise InputError(
            f"radio.statistics_file '{file}' has another content ({_digest(text)}) than when the scenario was stored "
            f"({expected}): put that back, or simulate again with --set radio.statistics_digest= and the file as it is"
        )
    return _in_file(file, text)


def with_digest(config: RadioConfig) -> RadioConfig:
    """Return a configuration that the user gave with the digest of the file of constants that it names, so that
    another content is another scenario. Raises InputError."""
    if config.statistics_file is None:
        return config
    statistics_of(config, asked=True)
    return config.model_copy(update={"statistics_digest": _digest(_text_of(config.statistics_file))})


def _text_of(file: str) -> str:
    try:
        return text_of(file)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"radio.statistics_file '{file}' cannot be read: {one_line(error)}") from error


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=8)
def _in_file(name: str, text: str) -> Statistics:
    try:
        return parse(json_of(text))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"no '{error.args[0]}'" if isinstance(error, KeyError) else one_line(error)
        raise InputError(f"{name}: not constants of a detector, as in {file_of()}: {what}") from error


def parse(data: dict[str, Any]) -> Statistics:
    """Return the constants in the file's form."""
    clutter = [
        (float(ratio), Clutter(np.array(table["mean"]), np.array(table["points"])))
        for ratio, table in data["clutter"].items()
    ]
    floor, company = data["floors"], sorted((float(ratio), value) for ratio, value in data["company"].items())
    return Statistics(
        dof=data["detection"]["dof"], gain=data["detection"]["gain"],
        overlap_centre_db=data["overlap"]["centre_db"], overlap_width_db=data["overlap"]["width_db"],
        trail=data["overlap"]["trail"], around=data["overlap"]["around"], sidelobes=data["overlap"]["sidelobes"],
        sidelobe_m=data["overlap"]["sidelobe_m"], noise_cells=data["noise_cells"],
        diffuse_floor=tuple(floor[n]["diffuse_at_0_db"] for n in ("distance_m", "azimuth_rad", "elevation_rad")),
        company=tuple(company),
        clutter=tuple(sorted(clutter, key=lambda item: item[0])),
        blur_m=BLUR_M * BLUR_BAND_HZ / data.get("bandwidth_hz", BLUR_BAND_HZ), standing=Standing(**data["standing"]),
    )  # fmt: skip
