"""The simulation of PHD-SLAM 3.0: 160 landmarks, four kilometres, a sensor of 150 m and 180 degrees with clutter.

Source: O. Kaltiokallio, R. Hostettler, Y. Ge, H. Kim, J. Talvitie, H. Wymeersch and M. Valkama, "A multihypotheses
importance density for SLAM in cluttered scenarios", IEEE Trans. Robotics 40, 2024, and the authors' repository
okaltiok/PHD-SLAM-3.0, commit 35a64de: landmarks, trajectory, parameters and results.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from cellslam.scenarios.known_worlds.known_world import (
    WHITE,
    Entry,
    Figure,
    KnownWorld,
    Returns,
    columns,
    one_link_a_site,
    plane_truth,
)
from cellslam.sim.frames import mean_velocity, wrap_angle
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, OdometryModel, Recording, Sites
from cellslam.slam.model.measurement_model import predict

STEPS, BLOCK = 4000, 100
REACH_M, SPAN_RAD = 150.0, 0.5 * math.pi
DETECTION, CLUTTER = 0.95, 5.0  # clutter is thinned by the probability of detection, too
STD = np.array([0.8, math.radians(0.3)])
ODOMETRY_STD = np.array([0.8, 0.0, 0.0, math.radians(0.5), 0.0, 0.0])
CONTROL_STD, SPEED_MPS = np.array([0.05, math.radians(0.03)]), 1.0
# Turn rates (rad/s) of the segments, and their lengths in steps.
SEGMENTS = (
    (300, 0.0), (500, math.pi / 250.0), (400, 0.0), (400, math.pi / 400.0), (500, 0.0), (400, -math.pi / 400.0),
    (500, 0.0), (300, 0.01096), (400, 0.0), (200, -math.pi / 200.0), (100, 0.0),
)  # fmt: skip
# The published trajectory every hundred steps: x, y (m), heading (rad, unwrapped).
WAYPOINTS = (
    (300.00, 400.00, -0.0873), (399.34, 391.30, -0.0906), (498.17, 382.10, -0.0919), (598.05, 372.93, -0.0906),
    (678.69, 421.27, 1.1635), (657.98, 513.28, 2.4206), (564.98, 522.10, 3.6786), (527.54, 436.68, 4.9268),
    (597.58, 373.68, 6.1775), (697.18, 363.06, 6.1786), (796.67, 352.16, 6.1725), (896.14, 341.35, 6.1761),
    (995.56, 330.46, 6.1749), (1090.14, 358.05, 6.9638), (1136.31, 443.18, 7.7518), (1108.48, 537.14, 8.5360),
    (1022.01, 584.08, 9.3222), (922.67, 594.35, 9.3191), (822.85, 604.80, 9.3271), (723.79, 614.57, 9.3280),
    (623.79, 624.24, 9.3293), (523.87, 633.68, 9.3290), (438.59, 679.46, 8.5365), (410.96, 773.05, 7.7450),
    (457.85, 857.71, 6.9478), (551.31, 883.74, 6.1598), (650.66, 871.73, 6.1686), (749.90, 859.84, 6.1629),
    (849.41, 847.64, 6.1582), (949.17, 835.33, 6.1614), (1048.83, 823.00, 6.1629), (1134.51, 861.90, 7.2610),
    (1139.07, 957.69, 8.3546), (1057.32, 1004.72, 9.4522), (957.38, 1002.24, 9.4486), (857.31, 999.63, 9.4530),
    (757.34, 996.72, 9.4602), (657.05, 993.07, 9.4628), (591.05, 1054.19, 7.8949), (652.41, 1120.87, 6.3218),
)  # fmt: skip
LANDMARKS_M = np.array((
    (515.267, 436.518), (740.131, 835.500), (571.051, 1112.517), (1069.541, 1042.277), (383.181, 836.664),
    (592.874, 579.547), (523.764, 525.779), (655.514, 1019.367), (644.770, 654.723), (929.610, 630.781),
    (834.994, 394.738), (475.978, 452.579), (790.449, 568.606), (872.387, 819.315), (619.596, 492.837),
    (410.059, 347.615), (1051.398, 774.433), (732.803, 646.131), (734.655, 967.332), (552.999, 594.029),
    (433.466, 429.674), (684.414, 572.058), (1100.303, 872.254), (484.417, 833.421), (1015.053, 961.725),
    (632.506, 329.129), (549.374, 566.571), (1160.906, 439.836), (677.276, 958.007), (970.238, 1044.593),
    (1099.052, 926.690), (743.358, 308.984), (701.580, 525.629), (702.245, 660.255), (925.052, 805.539),
    (703.325, 335.223), (386.525, 694.502), (864.005, 631.451), (774.668, 1159.674), (1069.470, 606.467),
    (995.944, 1035.583), (382.155, 436.029), (764.225, 574.489), (465.255, 619.095), (952.742, 961.533),
    (368.218, 767.094), (1044.669, 531.556), (1102.654, 466.885), (579.866, 485.166), (841.636, 805.664),
    (557.401, 1074.486), (951.357, 803.370), (584.837, 407.875), (706.535, 948.346), (566.944, 449.429),
    (1157.239, 984.018), (705.910, 905.461), (1162.949, 388.608), (864.743, 950.901), (896.076, 373.781),
    (983.083, 798.351), (497.365, 479.835), (1125.458, 331.683), (1083.382, 315.150), (455.224, 729.686),
    (665.066, 1080.828), (878.391, 302.649), (824.660, 879.474), (533.994, 663.479), (322.770, 352.844),
    (690.886, 1076.460), (1164.821, 852.989), (826.856, 1028.187), (1002.192, 359.381), (1198.975, 906.103),
    (694.822, 388.645), (632.892, 1149.699), (465.402, 414.639), (915.063, 1038.479), (527.230, 344.114),
    (1140.330, 547.507), (656.168, 434.415), (810.111, 312.054), (1047.723, 859.172), (775.738, 639.195),
    (357.906, 365.642), (569.561, 906.079), (1146.615, 809.760), (809.164, 647.649), (333.761, 445.418),
    (422.700, 881.958), (380.801, 722.358), (1081.398, 508.377), (727.875, 1084.798), (775.389, 1123.240),
    (587.873, 836.979), (662.214, 1167.379), (623.017, 1068.880), (593.525, 659.137), (638.642, 467.094),
    (618.966, 565.338), (545.952, 1023.670), (748.723, 1165.514), (623.128, 825.296), (737.203, 387.897),
    (862.610, 390.044), (952.541, 877.564), (967.727, 563.605), (1119.817, 581.725), (1170.726, 511.787),
    (776.721, 1091.700), (768.923, 966.384), (1037.794, 373.633), (906.761, 964.133), (587.045, 995.231),
    (1025.773, 611.655), (709.771, 1151.637), (1073.134, 976.018), (834.554, 636.363), (649.228, 576.544),
    (1087.396, 417.912), (1033.489, 1043.017), (419.607, 660.788), (852.641, 879.210), (444.069, 776.977),
    (541.323, 1049.251), (736.690, 1037.982), (837.024, 305.559), (911.374, 886.881), (889.584, 571.448),
    (780.044, 386.942), (306.218, 426.972), (1154.320, 360.408), (460.082, 701.307), (997.921, 557.973),
    (1175.299, 486.431), (821.583, 569.994), (681.408, 1032.154), (514.254, 908.325), (654.419, 830.343),
    (527.131, 851.581), (720.904, 582.969), (1178.221, 936.301), (927.637, 304.015), (376.539, 796.323),
    (430.895, 626.882), (606.413, 337.764), (453.087, 814.965), (976.817, 365.554), (870.932, 1028.051),
    (980.687, 861.597), (721.992, 468.771), (733.311, 894.911), (1074.679, 871.258), (896.396, 623.123),
    (616.115, 402.302), (437.019, 342.826), (491.938, 685.164), (463.793, 906.196), (606.703, 1159.251),
))  # fmt: skip


@cache
def trajectory() -> Floats:
    """Return the poses (T, 6), in m and rad: controls as published, drawn once, and in each block of 100 steps so
    corrected, by
    constant changes of speed and turn rate and one that grows, that they meet the published trajectory."""
    rng = np.random.default_rng(2024)
    turn = np.concatenate([np.full(count, rate) for count, rate in SEGMENTS])
    controls = np.column_stack([np.full(STEPS, SPEED_MPS), turn]) + CONTROL_STD * rng.standard_normal((STEPS, 2))
    poses = [np.array(WAYPOINTS[0])]
    for block, target in enumerate(WAYPOINTS[1:]):
        poses += _meeting(poses[-1], controls[block * BLOCK : (block + 1) * BLOCK], np.array(target))
    poses += _driven(poses[-1], controls[len(poses) - 1 : STEPS - 1])
    out = np.zeros((STEPS, 6))
    out[:, [0, 1, 3]] = poses
    out[:, 3] = wrap_angle(out[:, 3])
    return out


def _meeting(start: Floats, controls: Floats, target: Floats) -> list[Floats]:
    """Return the poses (x, y, heading) after each of the controls, corrected to end at a target (Newton's method)."""
    ramp, change = np.linspace(-1.0, 1.0, len(controls)), np.zeros(3)

    def end(c: Floats) -> list[Floats]:
        return _driven(start, controls + np.column_stack([np.full(len(ramp), c[0]), c[1] + c[2] * ramp]))

    for _ in range(8):
        miss = end(change)[-1] - target
        slopes = [(end(change + 1e-6 * axis)[-1] - target - miss) / 1e-6 for axis in np.eye(3)]
        change = change - np.linalg.solve(np.column_stack(slopes), miss)
    return end(change)


def _driven(start: Floats, controls: Floats) -> list[Floats]:
    """Return the poses (x, y, heading) after each second at a speed (m/s) and a turn rate (rad/s): exact arcs."""
    out, (x, y, h) = [], start
    for v, w in controls:
        x, y = x + v / w * (math.sin(h + w) - math.sin(h)), y + v / w * (math.cos(h) - math.cos(h + w))
        h += w
        out.append(np.array([x, y, h]))
    return out


def simulate(seed: int, trial: int) -> Recording:
    """Return the recording of a run: the same truth, new odometry and scans."""
    poses = trajectory()
    odometry = np.zeros((STEPS, 6))
    odometry[1:] = mean_velocity(poses[:-1], poses[1:], np.ones(STEPS - 1))
    odometry[1:] += ODOMETRY_STD * stream(seed, trial, Stream.ODOMETRY).standard_normal((STEPS - 1, 6))
    table, vt = columns(_scans(poses, seed, trial), stream(seed, trial, Stream.RECEIVER))
    none, site = np.zeros(6), np.zeros(len(LANDMARKS_M), np.int64)
    return Recording(
        time_s=np.arange(STEPS, dtype=np.float64), odometry=odometry,
        odometry_model=OdometryModel(ODOMETRY_STD, none, none, none), links=one_link_a_site(1),
        sites=Sites(("landmarks",), np.zeros(1), np.zeros(1)), measurements=table, start_pose=poses[0],
        start_std=none, provenance={"known_world": WORLD.name, "seed": seed, "trial": trial},
        truth=plane_truth(poses, LANDMARKS_M, site, vt, STD), plane=True,
    )  # fmt: skip


def _scans(poses: Floats, seed: int, trial: int) -> Returns:
    whole = np.column_stack([LANDMARKS_M, np.zeros(len(LANDMARKS_M))])
    seen = predict(poses[:, None, :], whole[None])[..., :2]
    visible = (seen[..., 0] <= REACH_M) & (np.abs(seen[..., 1]) <= SPAN_RAD)
    rng = stream(seed, trial, Stream.DETECTION)
    step, vt = np.nonzero(visible & (rng.random(visible.shape) < DETECTION))
    clutter = stream(seed, trial, Stream.CLUTTER)
    false = np.repeat(np.arange(STEPS), clutter.binomial(clutter.poisson(CLUTTER, STEPS), DETECTION))
    where = clutter.random((len(false), 2)) * [REACH_M, 2.0 * SPAN_RAD] - [0.0, SPAN_RAD]
    values = np.concatenate([seen[step, vt], where])
    values += STD * stream(seed, trial, Stream.NOISE).standard_normal(values.shape)
    values[:, 0] = np.abs(values[:, 0])
    values[:, 1] = wrap_angle(values[:, 1])
    snapshot = np.concatenate([step, false])
    return Returns(snapshot, np.zeros(len(snapshot), np.int64), np.append(vt, np.full(len(false), -1)), values)


# In a plane an elevation of zero counts as measured: densities have its factor.
_LEVEL_DEG = 0.3
_LEVEL = 1.0 / (math.sqrt(2.0 * math.pi) * math.radians(_LEVEL_DEG))
_OPTIONS = {
    **WHITE, "noise_floor_m": float(STD[0]), "noise_floor_azimuth_deg": 0.3, "noise_floor_elevation_deg": _LEVEL_DEG,
    "detection_probability": DETECTION, "visible_s": 1e4, "hidden_s": 1e5, "effective_share": 0.2, "confirm_hits": 3,
    "clutter_density": DETECTION * CLUTTER / (2.0 * REACH_M * SPAN_RAD) * _LEVEL,
}  # fmt: skip
_PUBLISHED = {1: (3.45, 0.42, 46.84), 10: (2.66, 0.34, 38.27), 100: (2.18, 0.29, 32.12)}
_FIGURES = (
    Figure("position RMSE", "position_rmse_m", "rmse", "m"),
    Figure("heading RMSE", "heading_rmse_rad", "rmse", "deg", math.degrees(1.0)),
    Figure("GOSPA of the final map", "map_gospa_m", "mean", "m"),
)
WORLD = KnownWorld(
    name="phd-slam-3",
    title="the simulation of PHD-SLAM 3.0: 160 landmarks, 4000 s, range and bearing with clutter",
    source="Kaltiokallio et al., IEEE Trans. Robotics 40, 2024; okaltiok/PHD-SLAM-3.0, README",
    simulate=simulate,
    figures=_FIGURES,
    entries=tuple(
        Entry(
            f"{n} particle{'' if n == 1 else 's'}", "phd-slam", {**_OPTIONS, "particles": n},
            dict(zip((f.name for f in _FIGURES), published, strict=True)),
        )
        for n, published in _PUBLISHED.items()
    ),
    trials=100,
    differences=(
        "The 4000 controls are drawn as published and corrected so that the drive meets the published trajectory "
        "every 100 steps; in between it differs by about a metre.",
        "Noise, detections and clutter are of other random numbers; measurements of a scan are shuffled.",
        "The published filter takes clutter as uniform over the area; here it is taken as it is drawn, uniform in "
        "range and bearing.",
        "The field of view is not given to the filter: it learns it from its measurements.",
        "The published estimate is the heaviest particle, here the mean over all; with one particle the mean of the "
        "importance density is taken in place of a draw.",
        "The published map has all 160 landmarks for truth, here those detected at least 20 times.",
    ),
)  # fmt: skip
