"""Joint filters at the start: which states there always are, which errors are states, and the arrays of a mixture."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.influence import Influence
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.snapshot.sizes_kernel import SIZES
from cellslam.slam.joint.state.layout import (
    ANCHOR,
    ENTRY,
    MOST_SCORE,
    NOBODY,
    POSE,
    SCORE,
    SLOT,
    VT_STATES,
    WEIGHT,
    ArrayErrors,
    Block,
    Core,
    FieldWeights,
    Filter,
    Learnt,
    Lost,
    Particles,
    Sums,
    Track,
    Vts,
)
from cellslam.slam.model.field_kernel import grid

LONGEST = 16  # snapshots in a block at most
STATES, VTS = 256, 48  # that a new filter can hold
MOST_STATES = 2040  # that a filter of all sites has, as a rule: memory that is not used costs nothing
LOST = 64  # confirmed VTs that one block can push out
# Spacing of cells and reach of bells, in scales. Correlations are right to 0.06 on the coarse grid, to 0.01 on the fine
# one, which has half as many cells again and is for an array whose distances err by twice what diffuse energy does.
COARSE_GRID, FINE_GRID = (1.1, 1.9), (0.9, 2.2)
ROOF_GRID = 1.3, 1.9  # right to 0.2
WIDE = grid(np.pi, 1.0, 1.0)  # of a field that does not exist

NO_ERRORS = ArrayErrors(
    calibration=np.zeros(3), calibration_grid=WIDE, roof=np.zeros(3), roof_grid=WIDE, diffuse=np.zeros(3),
    diffuse_m=0.0, sway=np.zeros(3), sway_s=0.0, tilt=np.zeros(2), tilt_s=1.0, ground=0.0,
)  # fmt: skip


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


def core_of(setup: Setup, errors: ArrayErrors, drawn: int = 0) -> Core:
    """Return the layout of the states that are always there; `drawn`: blocks of which the noise is a state."""
    model, sites, end = setup.odometry_model, setup.sites, POSE

    def indices(there: ArrayLike) -> Ints:
        """Return the next indices for the states that there are, -1 for the others."""
        nonlocal end
        number = np.cumsum(np.asarray(there, np.bool_))
        out = np.where(there, end - 1 + number, -1)
        end += int(number[-1]) if len(number) else 0
        return out

    sway, ground = indices(np.full(3, errors.sway.any())), int(indices([errors.ground > 0.0])[0])
    range_scale = int(indices([setup.range_scale_std > 0.0])[0])
    bias = indices((model.bias > 0.0) | (model.bias_walk_density > 0.0))
    scale, noise = indices(model.scale != 0.0), indices(model.noise_density != 0.0)
    first_offset, wander = end, sites.walk_densities
    indices(np.ones(len(sites), np.bool_))
    rate = indices((sites.drift_std_m_s > 0.0) | (wander[1] > 0.0))
    sums = np.array([indices(noise >= 0) for _ in range(drawn)], np.int64).reshape(drawn, POSE)
    step_m = np.array(sites.step_std_m)  # one that can be written: for others the kernels would be compiled again
    common = 0 if setup.map is None else setup.map.common_m.shape[2]
    return Core(
        sway=sway, ground=ground, range_scale=range_scale, bias=bias, scale=scale, noise=noise,
        first_offset=first_offset, rate=rate, wander=wander, step_m=step_m, drawn=sums, first_common=end,
        size=end + common,
    )  # fmt: skip


def new_mixture(
    setup: Setup, core: Core, errors: ArrayErrors, offsets_m: Floats, offset_std_m: Floats, vts: int = VTS,
    states: int = STATES,
) -> Mixture:  # fmt: skip
    """Return K filters at the start, without VTs.

    offsets_m (K, S): clock offsets, offset_std_m (S,): their deviations. All links are in use.
    """
    k, model, whole, vts = len(offsets_m), setup.odometry_model, np.int64, min(vts, VTS)
    x, p, variance = np.zeros((k, states)), np.zeros((k, states, states)), np.zeros(core.size)
    variance[:POSE] = setup.start_std**2
    variance[4:POSE] = np.maximum(variance[4:POSE], errors.tilt**2)
    if core.sway[0] >= 0:
        variance[core.sway] = errors.sway**2
    if core.ground >= 0:
        variance[core.ground] = errors.ground**2
    if core.range_scale >= 0:
        variance[core.range_scale] = setup.range_scale_std**2
    for of, std in ((core.bias, model.bias), (core.scale, model.scale)):
        variance[of[of >= 0]] = std[of >= 0] ** 2
    variance[core.offsets] = offset_std_m**2
    variance[core.common] = 1.0
    variance[core.rate[core.rate >= 0]] = setup.sites.drift_std_m_s[core.rate >= 0] ** 2
    x[:, :POSE], x[:, core.offsets] = setup.start_pose, offsets_m
    p[:, np.arange(core.size), np.arange(core.size)] = variance
    weights = sum(
        int((std > 0.0).sum()) * grid.cells
        for std, grid in ((errors.calibration, errors.calibration_grid), (errors.roof, errors.roof_grid))
    )
    anchor = np.zeros((k, vts, ANCHOR))
    anchor[:, :, WEIGHT], anchor[:, :, SCORE] = 1.0, MOST_SCORE
    state, slots = np.full((k, vts, VT_STATES), -1), np.zeros((k, vts, SLOT), whole)
    arrays = Filter(
        core=core, x=x, p=p, size=np.full((k, 1), core.size), owner=np.full((k, states), NOBODY),
        count=np.zeros((k, 1), whole), links=np.ones((k, len(setup.links)), whole),
        illuminators=np.full((k, len(setup.links)), -1),
        fields=FieldWeights(state=np.full((k, weights), -1), met=np.zeros((k, weights), whole)),
        vts=Vts(state=state, anchor=anchor, slots=slots, spread=np.zeros((k, vts, 6))),
        lost=Lost(rows=np.zeros((k, LOST, ENTRY)), used=np.zeros((k, 1), whole)),
        learnt=Learnt(sizes=np.zeros((k, 3, SIZES)), summed=np.zeros((k, 1)), nis=np.zeros((k, 2))),
        particles=Particles(deviation=np.zeros((k, states, 0)), weight=np.zeros((k, 0))),
    )  # fmt: skip
    track = Track(
        snapshots=np.zeros((k, 1), whole), pose=np.zeros((k, LONGEST, POSE)),
        deviation=np.zeros((k, LONGEST, POSE, 0)), at=np.zeros((k, LONGEST, 2)), total=np.zeros((k, 3)),
    )  # fmt: skip
    sums = Sums(
        detections=np.zeros((k, vts), whole), seen=np.zeros((k, vts, LONGEST), whole), e=np.zeros((k, vts, 3)),
        q=np.zeros((k, vts, 3)), measured=np.zeros((k, vts, 3)), diffuse=np.zeros((k, vts)), odds=np.zeros((k, vts)),
    )  # fmt: skip
    blocks = Block(track=track, sums=sums, shift=np.zeros((k, len(core.rate), 2)))
    return Mixture(arrays, blocks, np.zeros(k), Influence(np.zeros(k)))
