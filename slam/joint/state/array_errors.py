"""Errors that persist, as the states that a joint filter keeps of them."""

from __future__ import annotations

import numpy as np

from cellslam.slam.api import Setup
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.state.layout import ArrayErrors
from cellslam.slam.model.field_kernel import grid

# Spacing of cells and reach of bells, in scales. Correlations are right to 0.06 on the coarse grid, to 0.01 on the fine
# one, which has half as many cells again and is for an array whose distances err by twice what diffuse energy does.
COARSE_GRID, FINE_GRID = (1.1, 1.9), (0.9, 2.2)
ROOF_GRID = 1.3, 1.9  # right to 0.2
WIDE = grid(np.pi, 1.0, 1.0)  # of a field that does not exist

NO_ERRORS = ArrayErrors(np.zeros(3), WIDE, np.zeros(3), WIDE, np.zeros(3), 0.0, np.zeros(3), 0.0, np.zeros(2), 1.0, 0.0)


def array_errors(options: EkfSlamOptions, setup: Setup) -> ArrayErrors:
    """Return the errors that are states. No size, or no scale: no state.

    The calibration has the grid of the known one where it is to begin with that.
    What the odometry or the start says of pitch and roll belongs to the pose: then they are not redrawn.
    """
    o, sheet, known = options, setup.odometry_model, options.known_calibration
    seen = np.concatenate([sheet.noise_density[4:], sheet.bias[4:], setup.start_std[4:], setup.start_pose[4:]]).any()
    calibration, roof = np.radians([o.calibration_scale_deg, o.roof_scale_deg])
    spacing, reach = FINE_GRID if o.calibration[0] > 2.0 * o.diffuse[0] else COARSE_GRID
    own = grid(calibration, spacing, reach) if calibration > 0.0 else WIDE
    return ArrayErrors(
        calibration=o.calibration * (calibration > 0.0),
        calibration_grid=own if known is None else known.grid,
        roof=o.roof * (roof > 0.0),
        roof_grid=grid(roof, *ROOF_GRID) if roof > 0.0 else WIDE,
        diffuse=o.diffuse * (o.diffuse_scale_m > 0.0),
        diffuse_m=o.diffuse_scale_m,
        sway=o.sway[[1, 2, 2]] * (o.sway_scale_s > 0.0),
        sway_s=o.sway_scale_s,
        tilt=np.radians([o.pitch_deg, o.roll_deg]) * (not seen),
        tilt_s=o.attitude_scale_s,
        ground=o.ground_share,
    )
