"""The measurements of a snapshot with the variances that association, updates and births take.

Source: Priestley, "Spectral analysis and time series", 1981, section 5.3: how many independent draws a correlated
sequence is worth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from cellslam.sim.described import Described
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.measurements.fusion import FusedMeasurements
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings_kernel import Persisting, combine, repeats, share_new, white_variances

# Widths in distance (m), azimuth and elevation (rad) over which clutter lies about paths: what a missing component
# takes off its density.
CLUTTER_WIDTH = (20.0, 0.3, 0.25)
MOST_MERGED = 400.0  # times that one draw of what merged paths do is repeated, at most
_LOG_WIDTH = np.log(CLUTTER_WIDTH)


@dataclass(frozen=True, repr=False)
class Readings(Described):
    """The measurements of a snapshot (m,) with their variances.

    `z` (m, 3): distance (m), azimuth and elevation (rad), NaN where not measured. `single` (m, 3): variances of one
    measurement; `many` (m, 3): those with which an update counts for what it is worth; `fresh` (m, 3): those of a VT
    that begins (links that see the same one share its errors). `gap` (m,): what the log-density of clutter is greater
    by; `merged` (3,): variances that updates take beside `many`, for what merged paths do.
    """

    z: Floats
    single: Floats
    many: Floats
    fresh: Floats
    gap: Floats
    merged: Floats = field(default_factory=lambda: np.zeros(3))


def readings(
    measurements: FusedMeasurements, port_of: Ints, options: MeasurementOptions, turn_rad: float, moved_m: float
) -> Readings:
    """Return a snapshot's measurements with their variances; since the last one the vehicle has turned and moved so
    far.

    port_of (L,): a number for each pair of site and port.
    """
    z = np.stack([measurements.distance_m, measurements.azimuth_rad, measurements.elevation_rad], axis=1)
    persisting = Persisting(*options.persisting, options.scales)
    return Readings(z, *combine(
        z, measurements.link, port_of, measurements.white, measurements.ports, measurements.clutter_log_ratio,
        persisting, turn_rad, moved_m, _LOG_WIDTH,
    ))  # fmt: skip


def white_readings(
    measurements: FusedMeasurements, options: MeasurementOptions, turn_rad: float, moved_m: float
) -> Readings:
    """Return a snapshot's measurements for a filter that has the errors that persist as states: these are white but for
    those, and `single` has the diffuse error and the sway, too, which are not known before the update.

    A cause without a scale is white. Where paths merge, their directions err as no state does, for as long as the
    vehicle sees them so: for that a share of the roof's variance is counted, as often as one draw of it is repeated.
    """
    z = np.stack([measurements.distance_m, measurements.azimuth_rad, measurements.elevation_rad], axis=1)
    plain, diffuse, sway, merged = options.beside_states
    scale, change = math.radians(options.roof_scale_deg), abs(turn_rad) + abs(moved_m) / options.typical_range_m
    single, many, fresh, gap = white_variances(
        z,
        measurements.white,
        measurements.ports,
        measurements.clutter_log_ratio,
        plain,
        diffuse,
        sway,
        merged,
        _LOG_WIDTH,
    )
    often = min(repeats(scale, change), MOST_MERGED)
    return Readings(z, single, many, fresh, gap, merged * often)


def novelty(options: MeasurementOptions, turn_rad: float, moved_m: float) -> float:
    """Return how much of what a snapshot shows the last one has not shown: 1 where all errors are white.

    The variance of one measurement over that with which an update counts, as `combine` has them for a lone path, mean
    over distance, azimuth and elevation. The vehicle has turned and moved since the last snapshot.
    """
    persisting = Persisting(*options.persisting, options.scales)
    return float(share_new(persisting, options.noise[0], turn_rad, moved_m))
