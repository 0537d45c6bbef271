"""All thresholds of the path estimator: what each is, in which unit, and why it is so.

Lengths and resolutions in distance are those at 100 resource blocks of LTE; a receiver of another band multiplies them
by its `Demands.coarser`. Energies are compared with the disturbance per sample, a noise variance where there is no
other. The detection threshold itself, the search window and the rule of ghosts are keys of the scenario.

Source: own, measured with `python -m tools front-end`; docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import math

# Search. Shares are of the detection threshold.
COARSE_SHARE = 0.58  # of a cell that is tried: between the cells of the grid up to 2.4 dB are lost
PROMISING_SHARE = 0.85  # of what the first step of a one-path fit promises: less never becomes a path
FARTHEST_M, FARTHEST_RAD = 22.5, math.radians(20.0)  # that a one-path fit may end from its cell: else another's peak
MOST_FAILURES = 10  # cells that turn out to be noise or diffuse energy before the search ends
MOST_PATHS = 32  # of one link: more than any traced scene has
JOINT_EVERY = 4  # paths found one by one before all are fitted jointly

# Fits, by Levenberg-Marquardt.
COARSE_GAIN = 0.2  # noise variances that a step must gain while paths are searched
FINE_GAIN = 0.01  # the same in the last fit: a hundredth of a nat
MOST_STEPS = 12
LONGEST_STEP_M, LONGEST_STEP_RAD = 6.0, math.radians(9.0)  # of one step: about half a resolution cell
STEEPEST_RAD = math.radians(85.0)  # elevation at which azimuth is still defined
LEAST_DAMPING = 1e-3  # after a step in vain, and at the start
RIDGE = 1e-10  # of the largest element of the Gram matrix: keeps coincident paths solvable

# Disturbance around a cell, in bins of delay and steps of the searched directions.
GUARD_BINS, REFERENCE_BINS = 2, 3  # skipped, then averaged, before and behind the cell under test
LOCAL_EXCESS, AROUND_EXCESS = 1.7, 1.15  # times the noise, of few cells and of all ports: below is scatter
ALIKE = 0.1  # relative difference of noise over delay that is scatter of its estimate
SIDELOBES = 0.01  # mean energy of a delay peak over the reference cells, relative to the peak

# Diffuse energy of a path, and what looks like a path in it.
LEAD_M, TRAIL_M, BESIDE = 5.0, 150.0, 3  # from where to where behind the path; beams to its sides
DIFFUSE_MARGIN = 8.0  # times the energy around it that a path in it must have: it falls with delay, and fades

# Which paths of a joint fit stay.
SUSPECT_SHARE = 0.01  # of a path within reach: less may be a ghost of calibration error ...
SUSPECT_MARGIN = 1.4  # ... and must exceed the threshold by this factor
LEAST_RELIABLE_M, LEAST_RELIABLE_RAD = 8.0, (math.radians(16.0), math.radians(20.0))  # deviations: more is no estimate
TOUCHING_M = 40.0  # within which dropping one path may save another
CELL_M, CELL_RAD = 12.0, math.radians(18.0)  # within which a stronger path may stand for a weaker one

# Ports.
SATURATED_EXCESS = 25.0  # residual of a saturated port over that of others, which diffuse energy makes up to 15 ...
SATURATED_SHARE = 0.25  # ... and over its own power, of which calibration errors leave 1 %
UNEVEN = 0.4  # nepers of power from which the disturbance of a port differs from the others' by more than scatter
