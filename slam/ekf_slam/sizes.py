"""What a drive says of the sizes that a filter was told, as options and data sheet that fit better.

Sources: see `sizes_kernel`; the steps are Fisher scoring (Osborne, "Fisher's method of scoring", International
Statistical Review 60, 1992) on the logarithm of the sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
MOST = {"m": 100.0, "g": 90.0}  # m, deg


@dataclass(frozen=True)
class Sizes(Described):
    """Slope of the log-likelihood in each log size (Z,), its information (Z,), and the mean square (6,) of the
    odometry's biases and scales, in the units of its data sheet; NaN where there are none. `log_likelihood`: of the
    drive, to compare sizes by."""

    slope: Floats
    information: Floats
    bias: Floats
    scale: Floats
    log_likelihood: float

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

    return Sizes(
        f.sizes[0], f.sizes[1], squares(core.bias), squares(core.scale), float(bank.log_weight[best])
    )  # fmt: skip


def stepped(
    options: EkfSlamOptions, sheet: OdometryModel, found: Sizes, share: float = 1.0
) -> tuple[EkfSlamOptions, OdometryModel, dict[str, float]]:
    """Return options and data sheet (m/s and rad/s) whose sizes are a share of a step nearer to the likeliest, and the
    steps of their logarithms.

    Biases and scales, of which a drive has one draw each, only grow.
    """
    steps = {name: share * min(max(step, -MOST_STEP), MOST_STEP) for name, step in found.steps().items()}
    changed, noise = dict[str, float](), sheet.noise_density.copy()
    for name, step in steps.items():
        if name in COMPONENTS:
            noise[COMPONENTS.index(name)] *= math.exp(step)
            continue
        for key in keys_of(name):
            changed[key] = min(getattr(options, key) * math.exp(step), MOST[name[-1]])
    bias, scale = np.fmax(np.sqrt(found.bias), sheet.bias), np.fmax(np.sqrt(found.scale), sheet.scale)
    return (
        type(options)(**(options.model_dump() | changed)),
        replace(sheet, noise_density=noise, bias=bias, scale=scale),
        steps,
    )


def keys_of(name: str) -> tuple[str, ...]:
    """Return the options that a size of `OPTIONS` stands for."""
    part = name.removeprefix("noise_")
    return (name,) if part == name else (f"noise_floor_{part}", f"noise_unit_snr_{part}")
