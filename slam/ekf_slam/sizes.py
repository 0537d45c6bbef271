"""What a drive says of the sizes that a filter was told, as options and data sheet that fit better.

Sources: see `sizes_kernel`; the steps are Fisher scoring (Osborne, "Fisher's method of scoring", International
Statistical Review 60, 1992) on the logarithm of the sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellslam.sim.described import Described
from cellslam.sim.recording import COMPONENTS, Floats, Ints, OdometryModel
from cellslam.slam.ekf_slam.bank import Bank
from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions
from cellslam.slam.ekf_slam.snapshot.sizes_kernel import count_weight
from cellslam.slam.ekf_slam.state.layout import ArrayErrors, one_of

_PARTS = ("m", "azimuth_deg", "elevation_deg")
# Options that a size of the kernels stands for, in their order; those of the odometry are components of its data sheet.
OPTIONS = (
    *(f"noise_{part}" for part in _PARTS), *(f"diffuse_{part}" for part in _PARTS),
    "sway_azimuth_deg", "sway_elevation_deg", "sway_elevation_deg", *COMPONENTS,
    *(f"calibration_{part}" for part in _PARTS), *(f"roof_{part}" for part in _PARTS),
)  # fmt: skip
LEAST_INFORMATION = 10.0  # a size told less well than to a third is left as it is
SURE = 3.0  # but a slope of so many deviations says that it is too small
MOST_STEP = math.log(4.0)  # of one pass
# A field of direction can explain whatever goes on for long, as paths that merge: it does not become wider than this.
FIELDS, MOST_OF_FIELD = ("calibration_", "roof_"), 3.0
MOST = {"m": 100.0, "g": 90.0}  # m, deg


@dataclass(frozen=True)
class Sizes(Described):
    """Slope of the log-likelihood in each log size (Z,), its information (Z,), and the mean square (6,) of the
    odometry's biases and scales, in the units of its data sheet; NaN where there are none."""

    slope: Floats
    information: Floats
    bias: Floats
    scale: Floats

    @property
    def misfit(self) -> float:
        """Mean square of the slopes in their standard deviations, over the sizes that the drive tells: about 1 where
        they are right (score test; Rao, Proc. Cambridge Philosophical Society 44, 1948); 0 where it tells none."""
        squares = [slope * slope / information for slope, information in self._told().values()]
        return float(np.mean(squares)) if squares else 0.0

    def steps(self) -> dict[str, float]:
        """Return the step of each log size that the drive tells towards the likeliest: of options by their names, of
        the odometry's noise by its component."""
        return {name: slope / information for name, (slope, information) in self._told().items()}

    def deviations(self) -> dict[str, float]:
        """Return the standard deviation of each log size that the drive tells."""
        return {name: 1.0 / math.sqrt(information) for name, (_, information) in self._told().items()}

    def _told(self) -> dict[str, tuple[float, float]]:
        """Return slope and information of the sizes that the drive tells well enough."""
        out = {}
        for name in dict.fromkeys(OPTIONS):
            which = [k for k, other in enumerate(OPTIONS) if other == name]
            slope, information = float(self.slope[which].sum()), float(self.information[which].sum())
            too_small = slope > max(SURE * math.sqrt(information), 1.0)
            if information >= LEAST_INFORMATION or (too_small and information > 0.0):
                out[name] = (slope, information)
        return out


def sizes_of(bank: Bank, errors: ArrayErrors) -> Sizes:
    """Return what the likeliest filter of a bank has learnt; the bank's own counts stay as they are."""
    best, core = int(np.argmax(bank.log_weight)), bank.core
    f = one_of(bank.arrays, best)._replace(sizes=bank.arrays.sizes[best].copy())
    for place in np.flatnonzero(f.owner[: f.size[0]] >= 0):
        count_weight(f, errors, int(place))

    def squares(of: Ints) -> Floats:
        return np.array([f.x[i] ** 2 + f.p[i, i] if i >= 0 else np.nan for i in of])

    return Sizes(f.sizes[0], f.sizes[1], squares(core.bias), squares(core.scale))


class Sheets(NamedTuple):
    """What a filter is told: `options`, with the sizes of measurement errors, and the odometry's data sheet, m/s and
    rad/s."""

    options: EkfSlamOptions
    odometry: OdometryModel


def stepped(sheets: Sheets, found: Sizes, told: Sheets, share: float = 1.0) -> tuple[Sheets, dict[str, float]]:
    """Return sheets whose sizes are a share of a step nearer to the likeliest, and the steps of their logarithms.

    Biases and scales, of which a drive has one draw each, only grow. Sizes that the drive does not tell are as `told`:
    what a pass that was lost believed of them is not kept.
    """
    steps = {name: share * min(max(step, -MOST_STEP), MOST_STEP) for name, step in found.steps().items()}
    odometry, options = sheets.odometry, sheets.options
    changed, noise = dict[str, float](), told.odometry.noise_density.copy()
    for name in OPTIONS:
        if name in COMPONENTS:
            if name in steps:
                noise[COMPONENTS.index(name)] = odometry.noise_density[COMPONENTS.index(name)] * math.exp(steps[name])
            continue
        for key in keys_of(name):
            if name in steps:
                most = MOST_OF_FIELD * getattr(told.options, key) if name.startswith(FIELDS) else MOST[name[-1]]
                changed[key] = min(getattr(options, key) * math.exp(steps[name]), most)
            elif key in type(options).model_fields:  # no roof has an error of distance
                changed[key] = getattr(told.options, key)
    bias, scale = np.fmax(np.sqrt(found.bias), odometry.bias), np.fmax(np.sqrt(found.scale), odometry.scale)
    nearer = replace(odometry, noise_density=noise, bias=bias, scale=scale)
    return Sheets(type(options)(**(options.model_dump() | changed)), nearer), steps


def keys_of(name: str) -> tuple[str, ...]:
    """Return the options that a size of `OPTIONS` stands for."""
    part = name.removeprefix("noise_")
    return (name,) if part == name else (f"noise_floor_{part}", f"noise_unit_snr_{part}")
