"""What a drive says of the sizes that a filter assumes, as options and data sheet that fit better.

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
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.snapshot.sizes_kernel import DIFFUSE_SIZE, ODOMETRY, count_states, count_weight
from cellslam.slam.joint.state.layout import ArrayErrors

_PARTS = ("m", "azimuth_deg", "elevation_deg")
_WORDS = {
    "m": "distance", "azimuth_deg": "azimuth", "elevation_deg": "elevation",
    "u_x": "speed", "u_y": "speed to the left", "u_z": "speed upwards", "u_psi": "yaw rate", "u_theta": "pitch rate",
    "u_phi": "roll rate",
}  # fmt: skip
# Options that a size of the kernels stands for, in their order; those of the odometry are components of its data sheet.
OPTIONS = (
    *(f"noise_{part}" for part in _PARTS), *(f"diffuse_{part}" for part in _PARTS),
    "sway_azimuth_deg", "sway_elevation_deg", "sway_elevation_deg", *COMPONENTS,
    *(f"calibration_{part}" for part in _PARTS), *(f"roof_{part}" for part in _PARTS),
)  # fmt: skip
DIFFUSE = slice(DIFFUSE_SIZE, DIFFUSE_SIZE + 3)
# What is assumed of a size may be wrong by a factor: so much is known of its logarithm without the drive.
ASSUMED = 1.0 / math.log(5.0) ** 2
MOST_STEP = math.log(4.0)  # of one pass
# A field of direction can explain whatever goes on for long, as paths that merge: it does not become wider than this.
FIELDS, MOST_OF_FIELD = ("calibration_", "roof_"), 6.0
MOST = {"m": 100.0, "g": 90.0}  # m, deg
# What is assumed of a size is doubted from so many deviations of its slope on, and if it is wrong by such a factor.
DOUBTED, NOTABLE = 6.0, 1.35


@dataclass(frozen=True)
class Sizes(Described):
    """Slope of the log-likelihood in each log size (Z,), its information (Z,), what the information of white noise has
    `in_common` (Z,) with that of diffuse errors, and the mean square (6,) of the odometry's biases and scales, in the
    units of its data sheet; NaN where there are none. `grown`: how many times as large as assumed diffuse errors are
    taken for; their slopes are against these."""

    slope: Floats
    information: Floats
    in_common: Floats
    bias: Floats
    scale: Floats
    grown: float = 1.0

    def slopes(self) -> dict[str, tuple[float, float]]:
        """Return slope and information of each log size: of options by their names, of the odometry's noise by its
        component. Those that no error was seen of are left out."""
        out = {}
        for name in dict.fromkeys(OPTIONS):
            which = [k for k, other in enumerate(OPTIONS) if other == name]
            if (information := float(self.information[which].sum())) > 0.0:
                out[name] = (float(self.slope[which].sum()), information)
        return out

    def deviations(self) -> dict[str, float]:
        """Return the standard deviation of each log size, by the drive and by what was assumed."""
        return {name: 1.0 / math.sqrt(information + ASSUMED) for name, (_, information) in self.slopes().items()}

    def doubted(self) -> dict[str, float]:
        """Return by what factor sizes are likely to be larger than assumed, where that is surely not so (score test;
        Rao, Proc. Cambridge Philosophical Society 44, 1948)."""
        out = dict.fromkeys(OPTIONS[DIFFUSE], self.grown)
        for name, (slope, information) in self.slopes().items():
            if name.startswith("noise_"):
                slope, information = self._of_white_noise_alone(OPTIONS.index(name))
            # No mistake: an odometry better than assumed, as slip is rare; angles better than assumed, as paths seldom
            # merge.
            if slope >= 0.0 or name.endswith("_m"):
                out[name] = out.get(name, 1.0) * _surely(slope, information)
        return {name: factor for name, factor in out.items() if factor != 1.0}

    def _of_white_noise_alone(self, size: int) -> tuple[float, float]:
        """Return slope and information of a size of white noise whatever the diffuse errors' size is: most of a
        measurement is diffuse, and a little less of that is no lack of white noise (effective score; Neyman, "Optimal
        asymptotic tests of composite statistical hypotheses", 1959)."""
        slope, information = float(self.slope[size]), float(self.information[size])
        of_diffuse = float(self.information[size + DIFFUSE_SIZE])
        if of_diffuse == 0.0:
            return slope, information
        share = float(self.in_common[size]) / of_diffuse
        slope -= share * float(self.slope[size + DIFFUSE_SIZE])
        return slope, max(information - share * float(self.in_common[size]), 1.0)

    def remarks(self) -> list[str]:
        """Return a line that says which sizes are doubted, if any are."""
        found = ", ".join(f"{in_words(name)} {factor:.2g} times" for name, factor in self.doubted().items())
        return [f"errors do not look as large as assumed: {found}"] if found else []


def _surely(slope: float, information: float) -> float:
    """Return by what factor a size is likely to be larger than assumed; 1 where it may be as assumed."""
    factor = math.exp(max(-MOST_STEP, min(slope / information, MOST_STEP)))
    sure = abs(slope) > DOUBTED * math.sqrt(information) and not 1.0 / NOTABLE < factor < NOTABLE
    return factor if sure else 1.0


def growth(mixture: Mixture) -> float:
    """Return by what factor diffuse errors are surely larger than a mixture takes them for, 1 where they may be as
    large, or where no filter is as likely as all others together; otherwise all filters count again.

    Diffuse energy moves distance, azimuth and elevation: distances, which merged paths hardly move, speak for all.
    """
    weight = mixture.weights()
    slope, information, _ = mixture.likeliest.learnt.sizes[:, DIFFUSE_SIZE].tolist()
    factor = max(_surely(slope, information), 1.0) if information > 0.0 and weight.max() > 0.5 else 1.0
    if factor > 1.0:
        mixture.arrays.learnt.sizes[:, :, DIFFUSE] = mixture.arrays.learnt.sizes[:, 2, :DIFFUSE_SIZE] = 0.0
    return factor


def sizes_of(mixture: Mixture, errors: ArrayErrors, noise: Floats, grown: float) -> Sizes:
    """Return what the likeliest filter of a mixture has learnt; the mixture's own counts stay as they are.

    noise (6,): densities of the odometry's white noise, whose sums have not been taken in lately. grown: as in `Sizes`.
    """
    f, core = mixture.likeliest, mixture.core
    f = f._replace(learnt=f.learnt._replace(sizes=f.learnt.sizes.copy()))
    for index in np.flatnonzero(f.owner[: f.size[0]] >= 0):
        count_weight(f, errors, int(index))
    count_states(f, core.noise, ODOMETRY, noise**2 * f.learnt.summed[0])

    def squares(of: Ints) -> Floats:
        return np.array([f.x[i] ** 2 + f.p[i, i] if i >= 0 else np.nan for i in of])

    return Sizes(
        f.learnt.sizes[0], f.learnt.sizes[1], f.learnt.sizes[2], squares(core.bias), squares(core.scale), grown
    )


class Sheets(NamedTuple):
    """What a filter assumes: `options`, with the sizes of measurement errors, and the odometry's data sheet, m/s and
    rad/s."""

    options: EkfSlamOptions
    odometry: OdometryModel


def stepped(sheets: Sheets, found: Sizes, assumed: Sheets, share: float = 1.0) -> tuple[Sheets, float]:
    """Return sheets whose sizes are a share of a step nearer to the likeliest, and how far those of now are off.

    The likeliest: by what the drive says and what was `assumed`. Off by: mean square of the slopes in their deviations,
    over as many sizes as the drive tells: about 1 where they are right (score test; Rao, Proc. Cambridge Philosophical
    Society 44, 1948). Biases and scales, of which a drive has one draw each, only grow.
    """
    odometry, options = sheets.odometry, sheets.options
    changed, noise, squares, number = dict[str, float](), odometry.noise_density.copy(), 0.0, 0.0
    for name, (slope, information) in found.slopes().items():
        if name in COMPONENTS:
            at = COMPONENTS.index(name)
            now, first = {name: float(noise[at])}, {name: float(assumed.odometry.noise_density[at])}
        else:
            now, first = ({key: getattr(of.options, key) for key in keys_of(name)} for of in (sheets, assumed))
        if not (largest := max(now, key=lambda key: now[key])) or not now[largest]:
            continue
        slope -= ASSUMED * math.log(now[largest] / first[largest])
        squares += slope * slope / (information + ASSUMED)
        number += information / (information + ASSUMED)
        # The step is one of the variance: moments are matched at once where the error itself is measured.
        step = 0.5 * math.log1p(max(2.0 * slope / (information + ASSUMED), math.exp(-2.0 * MOST_STEP) - 1.0))
        factor = math.exp(share * min(step, MOST_STEP))
        if name in COMPONENTS:
            noise[at] *= factor
            continue
        for key in now:
            most = MOST_OF_FIELD * first[key] if name.startswith(FIELDS) else MOST[name[-1]]
            changed[key] = min(now[key] * factor, most)
    bias, scale = np.fmax(np.sqrt(found.bias), odometry.bias), np.fmax(np.sqrt(found.scale), odometry.scale)
    nearer = Sheets(
        type(options)(**(options.model_dump() | changed)),
        replace(odometry, noise_density=noise, bias=bias, scale=scale),
    )
    return nearer, squares / max(number, 1e-9)


def in_words(name: str) -> str:
    """Return a size of `OPTIONS` in words."""
    if name in COMPONENTS:
        return f"noise of the odometry's {_WORDS[name]}"
    cause, _, part = name.partition("_")
    return f"{'white noise' if cause == 'noise' else cause} of {_WORDS[part]}"


def keys_of(name: str) -> tuple[str, ...]:
    """Return the options that a size of `OPTIONS` stands for."""
    part = name.removeprefix("noise_")
    return (name,) if part == name else (f"noise_floor_{part}", f"noise_unit_snr_{part}")
