"""Compiled: what a drive says of the sizes that a filter assumes: are the errors as large as their data sheets say?

A size is a standard deviation. With s the error that it is of, V = size^2 what is assumed of it and m, v the mean and
the variance that the measurements leave of s, the slope of the log-likelihood in log size is the sum over all s of (m^2
+ v) / V - 1, and its information, about, of 2 ((V - v) / V)^2. Where the size is right the slope has mean zero and the
information as its variance: a test; their ratio is a step towards the likeliest size. The same measurements tell of
white noise and of diffuse errors: what the slopes of both have in common is summed up, too.

Sources: Fisher's identity, as in Louis, "Finding the observed information matrix when using the EM algorithm", J. Royal
Statistical Society B 44, 1982; Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5), 1972.
"""

from __future__ import annotations

from cellslam.sim.compiling import lean, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.observation_kernel import roof_first
from cellslam.slam.joint.state.layout import POSE, ArrayErrors, Filter
from cellslam.slam.joint.state.states_kernel import covariance_of
from cellslam.slam.model.matrices_kernel import Sym3, Vec3, dot, inverse, sym_vec

# Sizes: white noise and diffuse errors of distance, azimuth, elevation; sway in yaw, pitch, roll; white noise of the
# six velocities; calibration and roof, of distance, azimuth, elevation.
WHITE, DIFFUSE_SIZE, SWAY, ODOMETRY, CALIBRATION, ROOF, SIZES = 0, 3, 6, 9, 15, 18, 21
MOST2 = 4.0  # squared deviations
KNOWN_SHARE = 0.5  # of its variance, that a sum of noise keeps when the measurements have shown it
LONGEST_SUM_S = 60.0


@lean
def count(f: Filter, size: int, assumed: float, mean2: float, left: float) -> None:
    """Take in an error whose variance was assumed, of which the measurements leave a squared mean and a variance.

    The mean has the variance assumed - left. One of more than so many deviations counts as one of so many: it may be
    none of what sizes are of.
    """
    share = (assumed - left) / assumed
    f.learnt.sizes[0, size] += (min(mean2, MOST2 * (assumed - left)) + left) / assumed - 1.0
    f.learnt.sizes[1, size] += 2.0 * share * share


@lean
def count_white(f: Filter, e: Vec3, s: Sym3, q: Floats) -> None:
    """Take in the white noise of a measurement, of variances q (3,) in m^2 and rad^2.

    Its innovation is e with the covariance s, 0 and 1 where nothing was measured. An error of variance V in component
    c has the mean V (s^-1 e)_c and the variance V - V^2 (s^-1)_cc.
    """
    information = inverse(s)
    w = sym_vec(information, e)
    at = (w.x, w.y, w.z)
    own = (information.xx, information.yy, information.zz)
    for c in range(3):
        if at[c] != 0.0:
            count(f, WHITE + c, q[c], (q[c] * at[c]) ** 2, q[c] - q[c] * q[c] * own[c])


@lean
def count_diffuse(f: Filter, c: int, assumed: float, white: float, t: Vec3, e: Vec3, s: Sym3) -> None:
    """Take in by how much a measurement changes what is known of a diffuse error of component c: only news counts.

    assumed: its variance before; t: its covariance with the innovation e, of covariance s, in which that component has
    noise of variance `white`. It changes by t s^-1 e, and its variance by t s^-1 t.
    """
    gain = sym_vec(inverse(s), t)
    if assumed > 0.0:
        count(f, DIFFUSE_SIZE + c, assumed, dot(gain, e) ** 2, assumed - dot(gain, t))
        own = (gain.x, gain.y, gain.z)[c]
        f.learnt.sizes[2, WHITE + c] += 2.0 * white * own * own / assumed


@lean
def count_states(f: Filter, indices: Ints, first_size: int, assumed: Floats) -> None:
    """Take in states with variances `assumed` (n,), in m^2 and rad^2, sizes from the first on; -1: no such state."""
    for c in range(len(indices)):
        index = indices[c]
        if index >= 0 and assumed[c] > 0.0:
            count(f, first_size + c, assumed[c], f.x[index] ** 2, covariance_of(f, index, index))


@lean
def count_weight(f: Filter, a: ArrayErrors, index: int) -> None:
    """Take in the weight of a field that is the state of this index."""
    owner, first, std, size = f.owner[index], 0, a.calibration, CALIBRATION
    cells = a.calibration_grid.cells
    if owner >= roof_first(a):
        first, std, size, cells = roof_first(a), a.roof, ROOF, a.roof_grid.cells
    component = (owner - first) // cells
    for c in range(3):
        if std[c] > 0.0:
            if component == 0:
                count(f, size + c, 1.0, f.x[index] ** 2, covariance_of(f, index, index))
            component -= 1


@part
def count_motion(f: Filter, noise: Floats, dt: float) -> None:
    """Sum up the odometry's white noise, of densities (6,), over dt (s) more; once the measurements have shown the sum,
    or after a while, take it in and begin again."""
    f.learnt.summed[0] += dt
    time_s, known = f.learnt.summed[0], f.learnt.summed[0] > LONGEST_SUM_S
    for c in range(POSE):
        index, variance = f.core.noise[c], noise[c] * noise[c] * time_s
        known = known or (index >= 0 and variance > 0.0 and covariance_of(f, index, index) < KNOWN_SHARE * variance)
    if not known:
        return
    n, f.learnt.summed[0] = f.size[0], 0.0
    count_states(f, f.core.noise, ODOMETRY, noise * noise * time_s)
    for c in range(POSE):
        index = f.core.noise[c]
        if index >= 0:
            f.x[index] = 0.0
            f.particles.deviation[index] = 0.0
            f.p[index, :n] = 0.0
            f.p[:n, index] = 0.0
